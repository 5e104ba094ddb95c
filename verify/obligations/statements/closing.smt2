; At no instant t of a step of any length h has the gap closed by more than the shield says it does at most, the own vehicle
; holding an acceleration, the one ahead braking fully. Refuted: it has.
(set-info :status unsat)
(declare-const v Real)
(declare-const w Real)
(declare-const own Real)
(declare-const h Real)
(declare-const t Real)
(declare-const vt Real)
(declare-const xt Real)
(assert (and (>= v 0.0) (>= w 0.0) (>= t 0.0) (>= h t)))
(assert (moves v own t vt xt))
(define-fun largest-closing () Real
  {largest-closing})
(assert (> (- xt (covered w c t)) largest-closing))
(check-sat)
