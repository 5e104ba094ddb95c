; Up to the speed `kink`, a follower is not farther than the code assumes for `kink`. Refuted: it is, or `kink` is no speed between.
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
(define-fun least ((a Real) (b Real)) Real (ite (<= a b) a b))
(assert (and (<= low u) (<= u high)))
(assert (or (< kink low) (> kink high)
  (and (<= u kink) (> y (least pf
  {unfired-position-at-kink})))))
(check-sat)
