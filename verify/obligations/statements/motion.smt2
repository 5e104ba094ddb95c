; What the shield takes for motion is motion. Refuted: it is not.
(set-info :status unsat)
(declare-const v Real)
(declare-const a Real)
(declare-const h Real)
(assert (and (>= v 0.0) (>= h 0.0)))
(assert (not (moves v a h
  {moved-speed}
  {moved-covered})))
(check-sat)
