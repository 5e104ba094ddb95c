; A control: the familiar stopping distance alone is not enough where the own vehicle brakes harder. A solver must find a
; start beyond that distance from which full braking ends in contact, or these files prove nothing.
(set-info :status sat)
(declare-const g Real)
(declare-const v Real)
(declare-const w Real)
(declare-const s Real)
(assert (and (>= v 0.0) (>= w 0.0) (>= s 0.0) (<= v 40.0) (<= w 40.0)))
(assert (> g 0.0))
(assert (> g (- (/ (* v v) (* 2.0 b)) (/ (* w w) (* 2.0 c)))))
(assert (<= (- (+ g (covered w c s)) (covered v b s)) 0.0))
(check-sat)
