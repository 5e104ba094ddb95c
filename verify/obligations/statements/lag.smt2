; A step of full braking through an actuator that covers any share of its way to a command. The vehicle is at no instant t of it
; further than one that brakes at b at once from the speed z, which takes the place of its own in the kernel; nor does its z at the
; end exceed the other's speed. With invariance, the gap beyond the one demanded of z does not shrink. Refuted: one of them fails.
(set-info :status unsat)
(declare-const v Real)
(declare-const r Real)
(declare-const h Real)
(declare-const share Real)
(declare-const t Real)
(declare-const vt Real)
(declare-const xt Real)
(assert (and (>= v 0.0) (>= t 0.0) (> h 0.0) (>= h t) (> share 0.0) (<= share 1.0) (>= r (- b))))
(define-fun response () Real (- r (* share (+ b r))))
(define-fun own () Real (ite (and (<= v 0.0) (<= response 0.0)) 0.0 response))
(assert (moves v own t vt xt))
(define-fun z () Real
  {to-lose})
(define-fun z2 () Real
  {to-lose-after-braking})
(assert (or (> z2 (braked z b h)) (> xt (covered z b t))))
(check-sat)
