; A follower that fires at a sample has a speed between the two of the code. Refuted: it has not.
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
(assert (< {follower-spare} 0.0))
(assert (or (< u low) (> u high)))
(check-sat)
