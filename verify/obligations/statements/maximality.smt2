; Outside K, with the vehicle ahead braking fully, no held acceleration a >= -b leads back into K after a step of any length
; h without contact before. Contact is looked for at one instant t: where the two would be closest under full braking, or
; the step's end. Refuted: the way back is free of contact at t.
(set-info :status unsat)
(declare-const g Real)
(declare-const v Real)
(declare-const w Real)
(declare-const h Real)
(declare-const a Real)
(declare-const v2 Real)
(declare-const x Real)
(declare-const vt Real)
(declare-const xt Real)
(assert (and (>= v 0.0) (>= w 0.0) (> h 0.0)))
(assert (and (> g 0.0) (<= g (D v w))))
(assert (>= a (- b)))
(assert (moves v a h v2 x))
(assert (> (- (+ g (covered w c h)) x) (D v2 (braked w c h))))
(define-fun t () Real
  (ite (and (> b c) (< (* v c) (* w b)) (> v w) (< (- v w) (* h (- b c)))) (/ (- v w) (- b c)) h))
(assert (moves v a t vt xt))
(assert (> (- (+ g (covered w c t)) xt) 0.0))
(check-sat)
