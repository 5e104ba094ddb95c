; If a state is in K, and the gap open, after the vehicle ahead has braked fully for s, both hold after any other
; acceleration a >= -c as well. What the own vehicle did meanwhile is arbitrary: it ends at speed v, and x is the gap at the
; start less what it covered. Refuted: one of them fails.
(set-info :status unsat)
(declare-const x Real)
(declare-const v Real)
(declare-const w Real)
(declare-const s Real)
(declare-const a Real)
(declare-const w2 Real)
(declare-const y Real)
(assert (and (>= v 0.0) (>= w 0.0) (>= s 0.0)))
(assert (>= a (- c)))
(assert (moves w a s w2 y))
(assert (> (+ x (covered w c s)) (D v (braked w c s))))
(assert (or (<= (+ x y) 0.0) (<= (+ x y) (D v w2))))
(check-sat)
