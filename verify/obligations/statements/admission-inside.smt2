; What passes the shield's test, an action a of an actuator that responds at once and did r before, leaves a gap of at least the
; margin m after the largest closing inside a step (which is that: closing). Refuted: it does not.
(set-info :status unsat)
(declare-const g Real)
(declare-const v Real)
(declare-const w Real)
(declare-const r Real)
(declare-const a Real)
(declare-const h Real)
(declare-const m Real)
(assert (and (>= v 0.0) (>= w 0.0) (> h 0.0) (>= a (- b)) (> m 0.0)))
; Who stands and does not want to move is held.
(define-fun own () Real (ite (and (<= v 0.0) (<= a 0.0)) 0.0 a))
(assert
  {admits})
(define-fun largest-closing () Real
  {largest-closing})
(assert (< (- g largest-closing) m))
(check-sat)
