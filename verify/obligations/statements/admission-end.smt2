; What passes the shield's test, an action a of an actuator that responds at once and did r before, leads to a gap that is larger by
; the margin m than the kernel demands, if the vehicle ahead brakes fully (and if it does not: worst-leader). Refuted: it does not.
(set-info :status unsat)
(declare-const g Real)
(declare-const v Real)
(declare-const w Real)
(declare-const r Real)
(declare-const a Real)
(declare-const h Real)
(declare-const m Real)
(declare-const v2 Real)
(declare-const x Real)
(assert (and (>= v 0.0) (>= w 0.0) (> h 0.0) (>= a (- b)) (> m 0.0)))
; Who stands and does not want to move is held.
(define-fun own () Real (ite (and (<= v 0.0) (<= a 0.0)) 0.0 a))
(assert (moves v own h v2 x))
(assert
  {admits})
(assert (< (- (- (+ g (covered w c h)) x) (D v2 (braked w c h))) m))
(check-sat)
