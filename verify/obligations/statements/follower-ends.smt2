; The speeds `kink` and `high` suffice: if followers with these keep the gap m to an ego vehicle at `own`, at an instant t after firing, each
; follower that fires does. Refuted: one does not.
(set-info :status unsat)
(declare-const p Real)
(declare-const v Real)
(declare-const p0 Real)
(declare-const v0 Real)
(declare-const pf Real)
(declare-const uf Real)
(declare-const ps Real)
(declare-const us Real)
(declare-const y Real)
(declare-const u Real)
; The follower is between the fastest (pf, uf) and the slowest one (ps, us), and had not fired at the sample before (p0, v0).
(assert (and (<= y pf) (>= y ps) (<= us u) (<= u uf)))
(assert (<= y
  {unfired-position}))
(define-fun low () Real
  {low-speed})
(define-fun kink () Real
  {kink-speed})
(define-fun high () Real
  {high-speed})
; Farther by this after t: it gains e until rho, and then brakes at f.
(declare-const rho Real)
(declare-const f Real)
(declare-const t Real)
(declare-const own Real)
(declare-const m Real)
(assert (and (>= rho 0.0) (> f 0.0) (>= t 0.0) (>= us 0.0)))
(define-fun reached ((s Real)) Real
  (ite (<= t rho) (+ (* s t) (* 0.5 e t t)) (+ (* s rho) (* 0.5 e rho rho) (covered (+ s (* e rho)) f (- t rho)))))
(define-fun least ((a Real) (b Real)) Real (ite (<= a b) a b))
(assert (and (<= low u) (<= u high)))
(assert (>= (- own (least pf
  {unfired-position-at-kink}) (reached kink)) m))
(assert (>= (- own (least pf
  {unfired-position-at-high}) (reached high)) m))
(assert (< (- own y (reached u)) m))
(check-sat)
