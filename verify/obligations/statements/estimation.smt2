
; No less of the gap is spare than is computed from a gap that is seen too small at worst, an own speed too high and a speed ahead
; too low, whatever the lag. Refuted: less is.
(set-info :status unsat)
(declare-const g Real)
(declare-const v Real)
(declare-const w Real)
(declare-const seen-g Real)
(declare-const seen-v Real)
(declare-const seen-w Real)
(declare-const r Real)
(declare-const h Real)
(declare-const share Real)
(assert (and (<= seen-g g) (>= seen-v v) (>= v 0.0) (>= w seen-w) (>= seen-w 0.0)))
(assert (and (> h 0.0) (> share 0.0) (<= share 1.0) (>= r (- b))))
(define-fun spare () Real
  {spare})
(define-fun seen-spare () Real
  {seen-spare})
(assert (> seen-spare spare))
(check-sat)
