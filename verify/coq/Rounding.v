(** Loss of gap by rounding in double precision, in steps of full braking and in the shield's test.

    The Rust functions that the definitions stand for are named beside them, docs/kernel-theorems.md has the statements side by side. *)

From Coq Require Import Reals Lra Psatz.
From Flocq Require Import Core Relative.
Require Import Kernel.
Open Scope R_scope.

(** * One operation *)

(** The nearest number of 53 binary digits, ties to even: the result of an f64 operation without underflow or overflow. *)
Definition fl (x : R) : R := round radix2 (FLX_exp 53) ZnearestE x.

(** Half the distance of 1 from the next number: `U`. *)
Definition u : R := / 2 * bpow radix2 (- 53 + 1).

#[global] Instance fifty_three : Prec_gt_0 53.
Proof. reflexivity. Qed.

Theorem numbers_of_double_precision_are_these x : bpow radix2 (-1022) <= Rabs x -> round radix2 (FLT_exp (-1074) 53) ZnearestE x = fl x.
Proof. intros H. unfold fl. apply round_FLT_FLX. exact H. Qed.

Lemma u_small : 0 < u <= / 1000000.
Proof. unfold u. simpl. lra. Qed.

Lemma fl_is y : exists d, Rabs d <= u /\ fl y = y * (1 + d).
Proof. exact (relative_error_N_FLX_ex radix2 53 eq_refl (fun n => negb (Z.even n)) y). Qed.

Theorem an_operation_is_off_by_u y : Rabs (fl y - y) <= u * Rabs y.
Proof.
  destruct (fl_is y) as [d [Hd ->]]. replace (y * (1 + d) - y) with (d * y) by ring. rewrite Rabs_mult.
  apply Rmult_le_compat_r; [apply Rabs_pos | exact Hd].
Qed.

Lemma fl_within y B : Rabs y <= B -> - (u * B) <= fl y - y <= u * B.
Proof.
  intros H. pose proof (an_operation_is_off_by_u y) as E.
  assert (u * Rabs y <= u * B) by (apply Rmult_le_compat_l; [pose proof u_small; lra | exact H]).
  revert E. unfold Rabs at 1. destruct Rcase_abs; lra.
Qed.

Lemma fl_monotone x y : x <= y -> fl x <= fl y.
Proof. apply round_le; typeclasses eauto. Qed.

Lemma fl_0 : fl 0 = 0.
Proof. apply round_0. typeclasses eauto. Qed.

Opaque u fl.

(** [y'] is [y] up to [k] such errors. *)
Definition rel (k y' y : R) : Prop := exists d, Rabs d <= k * u /\ y' = y * (1 + d).

Lemma abs_le d e : - e <= d <= e -> Rabs d <= e.
Proof. intros. apply Rabs_le. lra. Qed.

Lemma of_abs d e : Rabs d <= e -> - e <= d <= e.
Proof. unfold Rabs. destruct Rcase_abs; lra. Qed.

Lemma product_small d e j k : 0 <= j <= 10 -> 0 <= k <= 10 -> - (j * u) <= d <= j * u -> - (k * u) <= e <= k * u ->
  - (/ 1000 * u) <= d * e <= / 1000 * u.
Proof.
  intros Hj Hk Hd He. pose proof u_small. apply of_abs. rewrite Rabs_mult.
  assert (Rabs d <= 10 * u) by (apply abs_le; nra). assert (Rabs e <= / 10000) by (apply abs_le; nra).
  replace (/ 1000 * u) with ((10 * u) * / 10000) by field.
  apply Rmult_le_compat; auto using Rabs_pos.
Qed.

Lemma rel_refl y : rel 0 y y.
Proof. exists 0. rewrite Rabs_R0. split; [lra | ring]. Qed.

Lemma rel_weaken j k y' y : j <= k -> rel j y' y -> rel k y' y.
Proof. intros H [d [Hd ->]]. exists d. split; [pose proof u_small; nra | reflexivity]. Qed.

Lemma rel_mul j k x' x y' y : 0 <= j <= 10 -> 0 <= k <= 10 -> rel j x' x -> rel k y' y -> rel (j + k + / 1000) (x' * y') (x * y).
Proof.
  intros Hj Hk [d [Hd ->]] [e [He ->]]. exists (d + e + d * e). apply of_abs in Hd, He.
  pose proof (product_small d e j k Hj Hk Hd He). split; [apply abs_le; lra | ring].
Qed.

Lemma rel_fl k y' y : 0 <= k <= 10 -> rel k y' y -> rel (k + 1 + / 1000) (fl y') y.
Proof.
  intros Hk [d [Hd ->]]. destruct (fl_is (y * (1 + d))) as [e [He ->]]. exists (d + e + d * e). apply of_abs in Hd, He.
  pose proof (product_small d e k 1 Hk ltac:(lra) Hd ltac:(lra)). split; [apply abs_le; lra | ring].
Qed.

Lemma rel_div j k x' x y' y : 0 <= j <= 5 -> 0 <= k <= 5 -> y <> 0 -> rel j x' x -> rel k y' y ->
  rel (j + k + / 100) (x' / y') (x / y).
Proof.
  intros Hj Hk Hy [d [Hd ->]] [e [He ->]]. apply of_abs in Hd, He. pose proof u_small.
  assert (- / 100000 <= e <= / 100000) by nra.
  exists ((d - e) / (1 + e)). split; [| field; lra].
  unfold Rdiv. rewrite Rabs_mult. rewrite (Rabs_right (/ (1 + e))) by (left; apply Rinv_0_lt_compat; lra).
  apply (Rmult_le_reg_r (1 + e)); [lra |]. rewrite Rmult_assoc, Rinv_l, Rmult_1_r by lra. apply abs_le. nra.
Qed.

Lemma rel_bounds k y' y B : 0 <= k -> rel k y' y -> Rabs y <= B -> - (k * u * B) <= y' - y <= k * u * B.
Proof.
  intros Hk [d [Hd ->]] Hy. apply of_abs. replace (y * (1 + d) - y) with (d * y) by ring. rewrite Rabs_mult.
  apply Rmult_le_compat; auto using Rabs_pos.
Qed.

(** * A step of motion *)

(** `motion::advance` in crates/sim/src/engine/motion.rs, operation by operation: position and speed. *)
Definition end_speed (v a dt : R) : R := fl (v + fl (a * dt)).
Definition advanced (x v a dt : R) : R :=
  if Rlt_dec (end_speed v a dt) 0 then fl (x + fl (fl (v * v) / fl (-2 * a)))
  else fl (fl (x + fl (v * dt)) + fl (fl (fl (/ 2 * a) * dt) * dt)).
Definition advanced_speed (v a dt : R) : R :=
  if Rlt_dec (end_speed v a dt) 0 then 0 else end_speed v a dt.

(** A step: t seconds, in double precision dt, positions up to X, speeds up to V, accelerations up to A. *)
Definition step_within (X V A t dt : R) : Prop :=
  0 <= V /\ 0 <= A /\ 0 < t /\ rel 1 dt t /\ 4 * (V * t + A * t * t) <= X.

Ltac facts :=
  pose proof u_small;
  match goal with H : step_within ?X ?V ?A ?t ?dt |- _ =>
    let HV := fresh in let HA := fresh in let Ht := fresh in let Hr := fresh in let HX := fresh in
    pose proof H as [HV [HA [Ht [Hr HX]]]];
    assert (0 <= V * t) by (apply Rmult_le_pos; lra);
    assert (0 <= A * t) by (apply Rmult_le_pos; lra);
    assert (0 <= A * t * t) by (apply Rmult_le_pos; lra);
    assert (0 <= X) by lra;
    assert (0 <= u * X) by (apply Rmult_le_pos; lra);
    assert (0 <= u * (V * t)) by (apply Rmult_le_pos; lra);
    assert (0 <= u * (A * t)) by (apply Rmult_le_pos; lra);
    assert (0 <= u * (A * t * t)) by (apply Rmult_le_pos; lra);
    assert (4 * (u * (V * t)) + 4 * (u * (A * t * t)) <= u * X)
      by (replace (4 * (u * (V * t)) + 4 * (u * (A * t * t))) with (u * (4 * (V * t + A * t * t))) by ring;
          apply Rmult_le_compat_l; lra);
    assert (u * X <= / 1000000 * X) by (apply Rmult_le_compat_r; lra);
    assert (u * (A * t) <= / 1000000 * (A * t)) by (apply Rmult_le_compat_r; lra)
  end.

Lemma gain_near X V A t dt a : step_within X V A t dt -> - A <= a <= A ->
  - (2.1 * (u * (A * t))) <= fl (a * dt) - a * t <= 2.1 * (u * (A * t)) /\ rel 2.1 (fl (a * dt)) (a * t).
Proof.
  intros H Ha. facts.
  assert (rel 2.1 (fl (a * dt)) (a * t)) as R.
  { apply (rel_weaken (0 + 1 + / 1000 + 1 + / 1000)); [lra |]. apply rel_fl; [lra |]. apply rel_mul; auto using rel_refl; lra. }
  split; [| exact R].
  assert (Rabs (a * t) <= A * t) as B by (rewrite Rabs_mult, (Rabs_right t) by lra; apply Rmult_le_compat_r; [lra | apply abs_le; lra]).
  pose proof (rel_bounds 2.1 _ _ _ ltac:(lra) R B). lra.
Qed.

(** Without a stop: speed and distance. *)
Lemma end_speed_near X V A t dt v a : step_within X V A t dt -> 0 <= v <= V -> - A <= a <= A ->
  - (u * V + 3.2 * (u * (A * t))) <= end_speed v a dt - (v + a * t) <= u * V + 3.2 * (u * (A * t)).
Proof.
  intros H Hv Ha. destruct (gain_near _ _ _ _ _ a H Ha) as [G _]. facts. unfold end_speed.
  assert (- (A * t) <= a * t <= A * t) by (split; nra).
  assert (Rabs (v + fl (a * dt)) <= V + 1.01 * (A * t)) as B by (apply abs_le; lra).
  pose proof (fl_within _ _ B). assert (u * (V + 1.01 * (A * t)) = u * V + 1.01 * (u * (A * t))) by ring. lra.
Qed.

Lemma way_near X V A t dt x v a : step_within X V A t dt -> - X <= x <= X -> 0 <= v <= V -> - A <= a <= A ->
  - (3.5 * (u * X)) <= fl (fl (x + fl (v * dt)) + fl (fl (fl (/ 2 * a) * dt) * dt)) - (x + v * t + a * t * t / 2) <= 3.5 * (u * X).
Proof.
  intros H Hx Hv Ha. facts.
  assert (rel 2.1 (fl (v * dt)) (v * t)) as Rp.
  { apply (rel_weaken (0 + 1 + / 1000 + 1 + / 1000)); [lra |]. apply rel_fl; [lra |]. apply rel_mul; auto using rel_refl; lra. }
  assert (rel 1.1 (fl (/ 2 * a)) (/ 2 * a)) as Rh.
  { apply (rel_weaken (0 + 1 + / 1000)); [lra |]. apply rel_fl; auto using rel_refl; lra. }
  assert (rel 3.2 (fl (fl (/ 2 * a) * dt)) (/ 2 * a * t)) as Rg.
  { apply (rel_weaken (1.1 + 1 + / 1000 + 1 + / 1000)); [lra |]. apply rel_fl; [lra |]. apply rel_mul; auto; lra. }
  assert (rel 5.3 (fl (fl (fl (/ 2 * a) * dt) * dt)) (/ 2 * a * t * t)) as Rq.
  { apply (rel_weaken (3.2 + 1 + / 1000 + 1 + / 1000)); [lra |]. apply rel_fl; [lra |]. apply rel_mul; auto; lra. }
  set (p := fl (v * dt)) in *. set (q := fl (fl (fl (/ 2 * a) * dt) * dt)) in *.
  assert (0 <= v * t <= V * t) by (split; nra).
  assert (- (A * t * t) <= a * t * t <= A * t * t).
  { assert (- (A * t) <= a * t <= A * t) by (split; nra). split; nra. }
  assert (Rabs (v * t) <= V * t) as Bp by (apply abs_le; lra).
  assert (Rabs (/ 2 * a * t * t) <= / 2 * (A * t * t)) as Bq by (apply abs_le; lra).
  pose proof (rel_bounds 2.1 _ _ _ ltac:(lra) Rp Bp) as Ep. pose proof (rel_bounds 5.3 _ _ _ ltac:(lra) Rq Bq) as Eq.
  assert (2.1 * u * (V * t) = 2.1 * (u * (V * t))) as E1 by lra. rewrite E1 in Ep.
  assert (5.3 * u * (/ 2 * (A * t * t)) = 2.65 * (u * (A * t * t))) as E2 by lra. rewrite E2 in Eq.
  assert (Rabs (x + p) <= 1.26 * X) as B1 by (apply abs_le; lra).
  pose proof (fl_within _ _ B1). assert (u * (1.26 * X) = 1.26 * (u * X)) by lra.
  assert (Rabs (fl (x + p) + q) <= 1.27 * X) as B2 by (apply abs_le; lra).
  pose proof (fl_within _ _ B2). assert (u * (1.27 * X) = 1.27 * (u * X)) by lra. lra.
Qed.

(** With a stop: after v/|a|, which is hardly later than t. *)
Lemma stopping X V A t dt x v a : step_within X V A t dt -> - X <= x <= X -> 0 <= v <= V -> - A <= a <= A -> end_speed v a dt < 0 ->
  a < 0 /\ v <= - a * t * (1 + 2.1 * u) /\
  - (3.5 * (u * X)) <= fl (x + fl (fl (v * v) / fl (-2 * a))) - (x + v * v / (-2 * a)) <= 3.5 * (u * X).
Proof.
  intros H Hx Hv Ha Hs. destruct (gain_near _ _ _ _ _ a H Ha) as [G [d [Hd Eg]]]. facts. apply of_abs in Hd.
  assert (- / 10000 <= d <= / 10000) by lra.
  unfold end_speed in Hs.
  assert (v + fl (a * dt) < 0) as Hn.
  { apply Rnot_le_lt. intros N. apply fl_monotone in N. rewrite fl_0 in N. lra. }
  rewrite Eg in Hn.
  assert (a < 0) as Hneg. { apply Rnot_le_lt. intros N. assert (0 <= a * t * (1 + d)) by (repeat apply Rmult_le_pos; lra). lra. }
  assert (v <= - a * t * (1 + 2.1 * u)) as Hv'.
  { assert (0 < - a * t) by (apply Rmult_lt_0_compat; lra). assert (0 <= (- a * t) * (2.1 * u - d)) by (apply Rmult_le_pos; lra). lra. }
  split; [exact Hneg |]. split; [exact Hv' |].
  assert (rel 3.3 (fl (fl (v * v) / fl (-2 * a))) (v * v / (-2 * a))) as Rw.
  { apply (rel_weaken (1.1 + 1.1 + / 100 + 1 + / 1000)); [lra |]. apply rel_fl; [lra |].
    apply rel_div; try lra; (apply (rel_weaken (0 + 1 + / 1000)); [lra |]; apply rel_fl; [lra | apply rel_refl]). }
  assert (0 <= v * v / (-2 * a) <= 0.51 * (V * t)) as Bw.
  { split; [apply Rmult_le_pos; [nra | left; apply Rinv_0_lt_compat; lra] |].
    apply (Rmult_le_reg_r (-2 * a)); [lra |]. unfold Rdiv. rewrite Rmult_assoc, Rinv_l, Rmult_1_r by lra.
    assert (v * v <= v * (- a * t * (1 + 2.1 * u))) by (apply Rmult_le_compat_l; lra).
    assert (0 <= v * (- a * t)) by (apply Rmult_le_pos; [lra | nra]).
    assert (v * (- a * t) <= V * (- a * t)) by (apply Rmult_le_compat_r; nra).
    assert (v * (- a * t) * (1 + 2.1 * u) <= v * (- a * t) * 1.02) by (apply Rmult_le_compat_l; lra). lra. }
  assert (Rabs (v * v / (-2 * a)) <= 0.51 * (V * t)) as Bw' by (apply abs_le; lra).
  pose proof (rel_bounds 3.3 _ _ _ ltac:(lra) Rw Bw') as Ew.
  assert (3.3 * u * (0.51 * (V * t)) = 1.683 * (u * (V * t))) as E1 by lra. rewrite E1 in Ew.
  set (w := fl (fl (v * v) / fl (-2 * a))) in *.
  assert (Rabs (x + w) <= 1.26 * X) as B1 by (apply abs_le; lra).
  pose proof (fl_within _ _ B1). assert (u * (1.26 * X) = 1.26 * (u * X)) by lra. lra.
Qed.
Lemma fl_negative y : y < 0 -> fl y < 0.
Proof.
  intros H. destruct (fl_is y) as [d [Hd ->]]. apply of_abs in Hd. pose proof u_small.
  assert (0 < - y * (1 + d)) by (apply Rmult_lt_0_compat; lra). lra.
Qed.

Lemma moves_on X V A t dt v a : step_within X V A t dt -> - A <= a <= A -> ~ end_speed v a dt < 0 -> - (2.1 * (u * (A * t))) <= v + a * t.
Proof.
  intros H Ha Hs. destruct (gain_near _ _ _ _ _ a H Ha) as [G _].
  apply Rnot_lt_le. intros N. apply Hs, fl_negative. lra.
Qed.

(** The vehicle ahead covers at least the distance of full braking, and is at least as fast afterwards, up to rounding. *)
Theorem the_vehicle_ahead_in_a_step X V A t dt x w a c : step_within X V A t dt -> - X <= x <= X -> 0 <= w <= V -> 0 < c -> c <= A ->
  - c <= a <= A ->
  x + covered w c t - 4 * (u * X) <= advanced x w a dt /\
  braked w c t - (u * V + 3.2 * (u * (A * t))) <= advanced_speed w a dt.
Proof.
  intros H Hx Hw Hc Hca Ha. assert (- A <= a <= A) as Ha' by lra. unfold advanced, advanced_speed.
  destruct (Rlt_dec (end_speed w a dt) 0) as [S | S].
  - destruct (stopping _ _ _ _ _ x _ _ H Hx Hw Ha' S) as [Hn [Hs E]]. facts. split.
    + assert (covered w c t <= w * w / (-2 * a)); [| lra].
      apply Rle_trans with (1 := covered_at_most w c t Hc).
      apply (Rmult_le_compat_l (w * w)); [nra |]. apply Rinv_le_contravar; lra.
    + assert (0 <= u * V) by (apply Rmult_le_pos; lra).
      assert (- a * t <= c * t) by (apply Rmult_le_compat_r; lra). assert (c * t <= A * t) by (apply Rmult_le_compat_r; lra).
      assert (- a * t * (2.1 * u) <= A * t * (2.1 * u)) by (apply Rmult_le_compat_r; lra).
      unfold braked. destruct Rle_dec; lra.
  - pose proof (way_near _ _ _ _ _ x _ _ H Hx Hw Ha') as E. pose proof (end_speed_near _ _ _ _ _ _ _ H Hw Ha') as Ev.
    pose proof (moves_on _ _ _ _ _ _ _ H Ha' S) as M. facts. split.
    + assert (covered w c t <= w * t + a * t * t / 2 + 1.05 * (u * (A * t * t))); [| lra].
      unfold covered. destruct (Rle_dec (c * t) w) as [N | N].
      * assert (- c * (t * t) <= a * (t * t)) by (apply Rmult_le_compat_r; nra). lra.
      * apply Rnot_le_lt in N. assert (w * w / (2 * c) <= w * t / 2).
        { apply (Rmult_le_reg_r (2 * c)); [lra |]. unfold Rdiv. rewrite Rmult_assoc, Rinv_l, Rmult_1_r by lra.
          assert (w * w <= w * (c * t)) by (apply Rmult_le_compat_l; lra). lra. }
        assert (0 <= t * (w + a * t + 2.1 * (u * (A * t)))) by (apply Rmult_le_pos; lra). lra.
    + assert (- c * t <= a * t) by (apply Rmult_le_compat_r; lra).
      unfold braked. destruct Rle_dec; lra.
Qed.

(** Substitute for the own speed, `ShieldParams::speed_to_lose_mps`. The actuator responds with r until the step's end and then
    approaches -B; rho is the rest of the step and of the lag. *)
Definition left_to_lose (B rho v r : R) : R :=
  if Rle_dec v 0 then if Rle_dec r 0 then 0 else v + rho * Rmax (r + B) 0 else v + rho * Rmax (r + B) 0.

(** The own acceleration: the actuator's response, noise up to n, and a rounded sum; a standing vehicle is held. *)
Definition drives (B n A v r a : R) : Prop :=
  - A <= a <= A /\ a <= Rmax r (- B) + n + u * A /\ (v <= 0 -> r <= 0 -> a <= 0).

Theorem a_response_with_noise_is_rounded B n A r noise : Rabs (r + noise) <= A -> noise <= n ->
  fl (r + noise) <= Rmax r (- B) + n + u * A.
Proof. intros H Hn. pose proof (fl_within _ _ H). pose proof (Rmax_l r (- B)). lra. Qed.

Theorem a_brake_less_noise_is_rounded B n A : 0 <= n <= B -> B <= A -> fl (B - n) <= B - n + u * A.
Proof. intros Hn HB. assert (Rabs (B - n) <= A) as H by (apply abs_le; lra). pose proof (fl_within _ _ H). lra. Qed.

Lemma left_to_lose_nonneg B rho v r : 0 <= rho -> 0 <= v -> 0 <= left_to_lose B rho v r.
Proof.
  intros Hr Hv. unfold left_to_lose. assert (0 <= rho * Rmax (r + B) 0) by (apply Rmult_le_pos; [lra | apply Rmax_r]).
  repeat destruct Rle_dec; lra.
Qed.

(** At any instant of the step. *)
Lemma own_way B n A rho v r a b t : 0 < b -> 0 <= A -> b <= B - n + u * A -> 0 <= t <= rho -> 0 <= v ->
  a <= Rmax r (- B) + n + u * A -> ~ (v <= 0 /\ r <= 0) ->
  v * t + a * t * t / 2 <= covered (left_to_lose B rho v r) b t + u * (A * t * t).
Proof.
  intros Hb HA HbB Ht Hv Ha N.
  assert (left_to_lose B rho v r = v + rho * Rmax (r + B) 0) as ->.
  { unfold left_to_lose. destruct Rle_dec; [destruct Rle_dec; [tauto |] |]; reflexivity. }
  pose proof (covered_at_least (v + rho * Rmax (r + B) 0) b t t Hb ltac:(lra)).
  assert (Rmax r (- B) = Rmax (r + B) 0 - B) as E by (unfold Rmax; repeat destruct Rle_dec; lra).
  rewrite E in Ha. set (m := Rmax (r + B) 0) in *. assert (0 <= m) by apply Rmax_r.
  assert (0 <= (m - b + 2 * (u * A) - a) * (t * t)) by (apply Rmult_le_pos; nra).
  assert (0 <= (rho - t) * m * t) by (repeat apply Rmult_le_pos; lra).
  assert (0 <= m * (t * t)) by (apply Rmult_le_pos; nra). lra.
Qed.

Lemma covered_rises z b s t : 0 < b -> 0 <= z -> 0 <= s <= t -> covered z b s <= covered z b t.
Proof.
  intros Hb Hz Hs. replace t with (s + (t - s)) by ring. rewrite covered_on by lra.
  pose proof (covered_at_least (braked z b s) b 0 (t - s) Hb ltac:(lra)). lra.
Qed.

(** Distance to a stop before t, or hardly later. *)
Lemma stopped_way A v a t (most : R -> R) : - A <= a < 0 -> 0 <= v <= - a * t * (1 + 2.1 * u) -> 0 < t ->
  (forall s, 0 <= s <= t -> v * s + a * s * s / 2 <= most s + u * (A * s * s)) -> (forall s, 0 <= s <= t -> most s <= most t) ->
  v * v / (-2 * a) <= most t + 2 * (u * (A * t * t)).
Proof.
  intros Ha Hv Ht W M. pose proof u_small. assert (0 <= u * A) by (apply Rmult_le_pos; lra).
  assert (0 <= u * A * (t * t)) by (apply Rmult_le_pos; [lra | nra]).
  destruct (half_square v (- a) ltac:(lra)) as [s [Es Ew]].
  replace (v * v / (-2 * a)) with (v * v / (2 * - a)) by (field; lra). rewrite Ew.
  assert (0 <= s). { apply Rnot_lt_le. intros N. assert (0 < - a * - s) by (apply Rmult_lt_0_compat; lra). lra. }
  assert (- a * s * s / 2 = v * s + a * s * s / 2) as E by (rewrite Es at 1; field).
  destruct (Rle_lt_dec s t) as [L | L].
  - rewrite E. specialize (W s ltac:(lra)). specialize (M s ltac:(lra)).
    assert (s * s <= t * t) by nra. assert (u * A * (s * s) <= u * A * (t * t)) by (apply Rmult_le_compat_l; lra). lra.
  - specialize (W t ltac:(lra)).
    assert (s - t <= 2.1 * u * t) as Hd.
    { apply (Rmult_le_reg_l (- a)); [lra |]. lra. }
    assert ((s - t) * (s - t) <= (2.1 * u * t) * (2.1 * u * t)) by (apply Rmult_le_compat; lra).
    assert (- a * s * s / 2 - (v * t + a * t * t / 2) = - a * ((s - t) * (s - t)) / 2) as Ed by (rewrite Es; field).
    assert (- a * ((s - t) * (s - t)) <= A * ((2.1 * u * t) * (2.1 * u * t))) by (apply Rmult_le_compat; nra).
    assert (A * ((2.1 * u * t) * (2.1 * u * t)) = 4.41 * u * (u * A * (t * t))) as E2 by lra.
    assert (4.41 * u * (u * A * (t * t)) <= / 1000 * (u * A * (t * t))) by (apply Rmult_le_compat_r; lra). lra.
Qed.

Theorem the_own_vehicle_in_a_step X V A t dt x v r a b B n rho : step_within X V A t dt -> - X <= x <= X -> 0 <= v <= V -> 0 < b ->
  0 <= n -> 0 <= B -> b <= B - n + u * A -> t <= rho -> drives B n A v r a ->
  advanced x v a dt <= x + covered (left_to_lose B rho v r) b t + 4 * (u * X) /\
  left_to_lose B (rho - t) (advanced_speed v a dt) r <= braked (left_to_lose B rho v r) b t + (u * V + 5.2 * (u * (A * t))).
Proof.
  intros H Hx Hv Hb Hn0 HB HbB Hrho [Ha [Hab Hheld]].
  pose proof (left_to_lose_nonneg B rho v r ltac:(destruct H; lra) ltac:(lra)) as Hz.
  assert (0 <= braked (left_to_lose B rho v r) b t) as Hbr by apply braked_nonneg.
  assert (0 <= covered (left_to_lose B rho v r) b t) as Hcov.
  { destruct H as [_ [_ [H _]]]. pose proof (covered_at_least (left_to_lose B rho v r) b 0 t Hb ltac:(lra)). lra. }
  assert (0 <= u * V) as HuV by (destruct H; pose proof u_small; apply Rmult_le_pos; lra).
  destruct (Rle_dec v 0) as [Z | Z]; [destruct (Rle_dec r 0) as [Zr | Zr] |].
  { (* stands *)
    specialize (Hheld Z Zr). assert (v = 0) as -> by lra.
    assert (advanced_speed 0 a dt <= 0) as Hs.
    { unfold advanced_speed, end_speed. destruct Rlt_dec; [lra |]. rewrite Rplus_0_l.
      destruct (gain_near _ _ _ _ _ a H Ha) as [_ [d [Hd E]]]. apply of_abs in Hd. facts.
      assert (fl (a * dt) <= 0) as N.
      { rewrite E. assert (0 <= - a * t * (1 + d)) by (repeat apply Rmult_le_pos; lra). lra. }
      apply fl_monotone in N. rewrite fl_0 in N. exact N. }
    facts. split.
    - unfold advanced. destruct (Rlt_dec (end_speed 0 a dt) 0) as [S | S].
      + destruct (stopping _ _ _ _ _ x _ _ H Hx Hv Ha S) as [Hneg [_ E]].
        assert (0 * 0 / (-2 * a) = 0) as E0 by (field; lra). lra.
      + pose proof (way_near _ _ _ _ _ x _ _ H Hx Hv Ha) as E. assert (a * (t * t) <= 0) by nra. lra.
    - unfold left_to_lose at 1. destruct (Rle_dec (advanced_speed 0 a dt) 0); [destruct (Rle_dec r 0) |]; lra. }
  all: assert (~ (v <= 0 /\ r <= 0)) as N by tauto.
  all: assert (left_to_lose B rho v r = v + rho * Rmax (r + B) 0) as Ez
    by (unfold left_to_lose; destruct (Rle_dec v 0); [destruct (Rle_dec r 0); [tauto |] |]; reflexivity).
  all: assert (Rmax r (- B) = Rmax (r + B) 0 - B) as Em by (unfold Rmax; repeat destruct Rle_dec; lra).
  all: pose proof (Rmax_r (r + B) 0) as Hm.
  all: pose proof (fun s Hs => own_way B n A rho v r a b s Hb ltac:(destruct H; lra) HbB Hs ltac:(lra) Hab N) as W.
  all: unfold advanced, advanced_speed; destruct (Rlt_dec (end_speed v a dt) 0) as [S | S];
    [ destruct (stopping _ _ _ _ _ x _ _ H Hx Hv Ha S) as [Hneg [Hs E]]; clear S; facts; split
    | pose proof (way_near _ _ _ _ _ x _ _ H Hx Hv Ha) as E; pose proof (end_speed_near _ _ _ _ _ _ _ H Hv Ha) as Ev; facts; split ].
  (* with a stop: the distance *)
  all: try (assert (v * v / (-2 * a) <= covered (left_to_lose B rho v r) b t + 2 * (u * (A * t * t))) as C; [| lra];
    apply (stopped_way A v a t (fun s => covered (left_to_lose B rho v r) b s)); try lra;
    [ intros s Hs'; apply W; lra | intros s Hs'; apply covered_rises; lra ]).
  (* with a stop: the speed *)
  all: try (unfold left_to_lose at 1; destruct (Rle_dec 0 0); [| lra]; destruct (Rle_dec r 0); [lra |];
    assert (Rmax (r + B) 0 = r + B) as Er by (apply Rmax_left; lra); rewrite Er in *;
    assert (0 <= (B - n + u * A - b) * t) by (apply Rmult_le_pos; lra); assert (0 <= r * t) by (apply Rmult_le_pos; lra);
    assert (0 <= n * t) by (apply Rmult_le_pos; lra);
    rewrite Ez; unfold braked; destruct Rle_dec; lra).
  (* without: the distance *)
  all: try (specialize (W t ltac:(lra)); lra).
  (* without: the speed *)
  all: assert (left_to_lose B (rho - t) (end_speed v a dt) r <= Rmax 0 (end_speed v a dt + (rho - t) * Rmax (r + B) 0)) as L
    by (unfold left_to_lose; pose proof (Rmax_l 0 (end_speed v a dt + (rho - t) * Rmax (r + B) 0));
        pose proof (Rmax_r 0 (end_speed v a dt + (rho - t) * Rmax (r + B) 0)); repeat destruct Rle_dec; lra).
  all: assert (0 <= (Rmax r (- B) + n + u * A - a) * t) by (apply Rmult_le_pos; lra).
  all: assert (0 <= (B - n + u * A - b) * t) by (apply Rmult_le_pos; lra).
  all: rewrite Em in *; rewrite Ez; rewrite Ez in Hbr.
  all: apply Rle_trans with (1 := L); apply Rmax_lub; [lra |].
  all: unfold braked; destruct Rle_dec; lra.
Qed.
(** * Effect of speed errors on the demanded gap *)

Lemma covered_of_more v r e t : 0 < r -> 0 <= v -> 0 <= e -> 0 <= t -> covered (v + e) r t <= covered v r t + e * t.
Proof.
  intros Hr Hv He Ht. destruct (covered_is (v + e) r t) as [s [Hs [_ ->]]]; try lra.
  pose proof (covered_at_least v r s t Hr Hs). assert (e * s <= e * t) by (apply Rmult_le_compat_l; lra). lra.
Qed.

Theorem the_demand_rises_with_errors_of_speeds b c v w v' w' e : 0 < b -> 0 < c -> 0 <= v -> 0 <= w -> 0 <= v' -> 0 <= w' ->
  forall e', 0 <= e -> 0 <= e' -> v' <= v + e -> w <= w' + e' -> D b c v' w' <= D b c v w + v' / b * (e + e').
Proof.
  intros Hb Hc Hv Hw Hv' Hw' e' He He' Ev Ew.
  destruct (demanded_is_needed b c v' w') as [t [Ht <-]]; try assumption.
  assert (0 <= v' / b) as Hq by (apply Rmult_le_pos; [lra | left; apply Rinv_0_lt_compat; lra]).
  assert (b * (v' / b) = v') as Eq by (field; lra).
  assert (exists s, 0 <= s <= v' / b /\ closing b c v' w' t <= closing b c v' w' s) as [s [Hs C]].
  { destruct (Rle_lt_dec t (v' / b)) as [L | L]; [exists t; lra |]. exists (v' / b). split; [lra |]. unfold closing.
    assert (v' <= b * t) by (rewrite <- Eq at 1; apply Rmult_le_compat_l; lra).
    rewrite (covered_stopped v' b t), (covered_stopped v' b (v' / b)) by lra.
    pose proof (covered_rises w' c (v' / b) t Hc Hw' ltac:(lra)). lra. }
  apply Rle_trans with (1 := C). clear t Ht C. unfold closing.
  pose proof (covered_increases v' (v + e) b s Hb ltac:(lra) ltac:(lra)).
  pose proof (covered_increases w (w' + e') c s Hc ltac:(lra) ltac:(lra)).
  pose proof (covered_of_more v b e s Hb Hv He ltac:(lra)). pose proof (covered_of_more w' c e' s Hc Hw' He' ltac:(lra)).
  pose proof (demanded_is_enough b c v w s Hb Hc Hv Hw ltac:(lra)) as M. unfold closing in M.
  assert ((e + e') * s <= (e + e') * (v' / b)) by (apply Rmult_le_compat_l; lra). lra.
Qed.

(** * Loss of spare gap in a step of full braking *)

(** For the numbers of the simulation; len is the length of the vehicle ahead. *)
Definition spare (b c len xf x z w : R) : R := xf - len - x - D b c z w.

Theorem motion_takes_at_most X V A t dt xf x v w r a af b c B n rho len Z : step_within X V A t dt ->
  - X <= xf <= X -> - X <= x <= X -> 0 <= v <= V -> 0 <= w <= V -> 0 < b -> 0 < c <= A -> 0 <= n -> 0 <= B -> b <= B - n + u * A ->
  t <= rho -> - c <= af <= A -> drives B n A v r a ->
  left_to_lose B (rho - t) (advanced_speed v a dt) r <= Z ->
  spare b c len xf x (left_to_lose B rho v r) w - u * (8 * X + Z / b * (2 * V + 8.4 * A * t)) <=
  spare b c len (advanced xf w af dt) (advanced x v a dt) (left_to_lose B (rho - t) (advanced_speed v a dt) r) (advanced_speed w af dt).
Proof.
  intros H Hxf Hx Hv Hw Hb Hc Hn HB HbB Hrho Haf Hd HZ.
  destruct (the_vehicle_ahead_in_a_step _ _ _ _ _ xf w af c H Hxf Hw) as [F1 F2]; try lra.
  destruct (the_own_vehicle_in_a_step _ _ _ _ _ x v r a b B n rho H Hx Hv Hb Hn HB HbB Hrho Hd) as [O1 O2].
  assert (forall s a', 0 <= advanced_speed s a' dt) as Hpos.
  { intros s a'. unfold advanced_speed. destruct Rlt_dec; lra. }
  facts. pose proof (Hpos v a) as Hv'. pose proof (Hpos w af) as Hw'.
  pose proof (left_to_lose_nonneg B rho v r ltac:(lra) ltac:(lra)) as Hz.
  pose proof (left_to_lose_nonneg B (rho - t) _ r ltac:(lra) Hv') as Hz'.
  set (z := left_to_lose B rho v r) in *. set (z' := left_to_lose B (rho - t) (advanced_speed v a dt) r) in *.
  set (w' := advanced_speed w af dt) in *.
  pose proof (full_braking_keeps_the_spare_gap b c (xf - len - x) z w t Hb ltac:(lra) Hz ltac:(lra) ltac:(lra)) as K.
  unfold closing in K.
  assert (0 <= u * V) by (apply Rmult_le_pos; lra).
  pose proof (the_demand_rises_with_errors_of_speeds b c (braked z b t) (braked w c t) z' w' (u * V + 5.2 * (u * (A * t)))
    Hb ltac:(lra) (braked_nonneg _ _ _) (braked_nonneg _ _ _) Hz' Hw' (u * V + 3.2 * (u * (A * t))) ltac:(lra) ltac:(lra) O2 ltac:(lra)) as L.
  assert (z' / b <= Z / b) as Q by (apply Rmult_le_compat_r; [left; apply Rinv_0_lt_compat |]; lra).
  set (e := u * V + 5.2 * (u * (A * t)) + (u * V + 3.2 * (u * (A * t)))) in *.
  assert (z' / b * e <= Z / b * e) by (apply Rmult_le_compat_r; unfold e; lra).
  assert (u * (8 * X + Z / b * (2 * V + 8.4 * A * t)) = 8 * (u * X) + Z / b * e) as -> by (unfold e; lra).
  unfold spare. lra.
Qed.

(** * The actuator *)

(** `ShieldParams::response_mps2`, operation by operation; `Actuator::respond` is equal, or returns the due command exactly without lag
    and delay. *)
Definition responded (share r due : R) : R := fl (r + fl (share * fl (due - r))).

Theorem a_response_is_rounded share r due P : 0 <= share <= 1 -> - P <= due - r <= P -> - P <= r + share * (due - r) <= P ->
  - (3.1 * (u * P)) <= responded share r due - (r + share * (due - r)) <= 3.1 * (u * P).
Proof.
  intros Hs Hd Hr. pose proof u_small. assert (0 <= P) by lra. assert (0 <= u * P) by (apply Rmult_le_pos; lra).
  assert (u * P <= / 1000000 * P) by (apply Rmult_le_compat_r; lra).
  assert (rel 2.01 (fl (share * fl (due - r))) (share * (due - r))) as Rq.
  { apply (rel_weaken (0 + (0 + 1 + / 1000) + / 1000 + 1 + / 1000)); [lra |]. apply rel_fl; [lra |].
    apply rel_mul; try lra; [apply rel_refl | apply rel_fl; [lra | apply rel_refl]]. }
  assert (Rabs (share * (due - r)) <= P) as Bq.
  { rewrite Rabs_mult, (Rabs_right share) by lra. assert (Rabs (due - r) <= P) by (apply abs_le; lra).
    pose proof (Rabs_pos (due - r)). nra. }
  pose proof (rel_bounds 2.01 _ _ _ ltac:(lra) Rq Bq) as E. unfold responded.
  set (q := fl (share * fl (due - r))) in *.
  assert (Rabs (r + q) <= 1.01 * P) as B by (apply abs_le; lra).
  pose proof (fl_within _ _ B). lra.
Qed.

(** The lag that remains at the end of a step is tau = h (1 - share) / share, `ShieldParams::lag_s`; the next response is held over h. *)
Theorem the_response_takes_at_most share h v r B P w b c xf len x Z : 0 < share <= 1 -> 0 < h -> 0 <= v -> 0 <= w -> 0 < b -> 0 < c -> 0 <= B ->
  - (2 * B) <= r -> - P <= - B - r <= P -> - P <= response B share r <= P ->
  let tau := h * (1 - share) / share in
  let r' := responded share r (- B) in
  left_to_lose B (tau + h) v r' <= Z ->
  spare b c len xf x (left_to_lose B tau v r) w - u * (3.1 * (Z / b) * (tau + h) * P) <=
  spare b c len xf x (left_to_lose B (tau + h) v r') w.
Proof.
  intros Hs Hh Hv Hw Hb Hc HB Hr2 Hd Hr tau r' HZ. pose proof u_small.
  assert (0 <= tau) as Htau. { unfold tau, Rdiv. apply Rmult_le_pos; [apply Rmult_le_pos; lra | left; apply Rinv_0_lt_compat; lra]. }
  assert ((tau + h) * (1 - share) = tau) as Et by (unfold tau; field; lra).
  pose proof (a_response_is_rounded share r (- B) P ltac:(lra) Hd Hr) as E. fold r' in E.
  unfold response in Hr. assert (0 <= P) by lra. assert (0 <= u * P) by (apply Rmult_le_pos; lra).
  pose proof (left_to_lose_nonneg B tau v r Htau Hv) as Hz. pose proof (left_to_lose_nonneg B (tau + h) v r' ltac:(lra) Hv) as Hz'.
  set (e := (tau + h) * (3.1 * (u * P))). assert (0 <= e) as He by (apply Rmult_le_pos; lra).
  assert (left_to_lose B (tau + h) v r' <= left_to_lose B tau v r + e) as L.
  { assert (v <= 0 -> r <= 0 -> r' <= 0) as Held.
    { intros _ Hr0. unfold r', responded. assert (fl (r + fl (share * fl (- B - r))) <= fl 0); [| rewrite fl_0 in *; assumption].
      apply fl_monotone. destruct (fl_is (- B - r)) as [d [Hd1 ->]]. destruct (fl_is (share * ((- B - r) * (1 + d)))) as [d' [Hd2 ->]].
      apply of_abs in Hd1, Hd2. destruct (Rle_lt_dec 0 (- B - r)) as [G | G].
      - assert (share * ((- B - r) * (1 + d)) * (1 + d') <= 1 * ((- B - r) * 1.001) * 1.001).
        { repeat (apply Rmult_le_compat; try lra); repeat apply Rmult_le_pos; lra. } lra.
      - assert (0 <= share * ((B + r) * (1 + d)) * (1 + d')) by (repeat apply Rmult_le_pos; lra). lra. }
    assert (0 <= (tau + h) * Rmax (r' + B) 0) by (apply Rmult_le_pos; [lra | apply Rmax_r]).
    assert (Rmax (r' + B) 0 <= (1 - share) * Rmax (r + B) 0 + 3.1 * (u * P)) as M.
    { pose proof (Rmax_r (r + B) 0). pose proof (Rmax_l (r + B) 0).
      assert (0 <= (1 - share) * Rmax (r + B) 0) by (apply Rmult_le_pos; lra).
      assert ((1 - share) * (r + B) <= (1 - share) * Rmax (r + B) 0) by (apply Rmult_le_compat_l; lra).
      apply Rmax_lub; lra. }
    assert ((tau + h) * Rmax (r' + B) 0 <= tau * Rmax (r + B) 0 + e).
    { apply Rle_trans with ((tau + h) * ((1 - share) * Rmax (r + B) 0 + 3.1 * (u * P))); [apply Rmult_le_compat_l; lra |].
      rewrite Rmult_plus_distr_l, <- Rmult_assoc, Et. unfold e. lra. }
    assert (0 <= tau * Rmax (r + B) 0) by (apply Rmult_le_pos; [lra | apply Rmax_r]).
    unfold left_to_lose. destruct (Rle_dec v 0) as [S | S]; [destruct (Rle_dec r 0) as [S' | S'] |].
    - specialize (Held S S'). destruct (Rle_dec r' 0); lra.
    - destruct (Rle_dec r' 0); lra.
    - lra. }
  pose proof (the_demand_rises_with_errors_of_speeds b c _ w _ w e Hb Hc Hz Hw Hz' Hw 0 He ltac:(lra) L ltac:(lra)) as M.
  set (z' := left_to_lose B (tau + h) v r') in *.
  assert (z' / b <= Z / b) as Q by (apply Rmult_le_compat_r; [left; apply Rinv_0_lt_compat |]; lra).
  assert (z' / b * (e + 0) <= Z / b * e) by (rewrite Rplus_0_r; apply Rmult_le_compat_r; lra).
  assert (u * (3.1 * (Z / b) * (tau + h) * P) = Z / b * e) as -> by (unfold e; lra).
  unfold spare. lra.
Qed.
(** * Continued braking *)

Record state := State { front : R; rear : R; own : R; ahead : R; response_now : R; time_left : R }.

Record bounds := Bounds {
  positions : R; speeds : R; accelerations : R; responses : R; replaced : R; (* X, V, A, P, Z *)
  step : R; part : R; part_computed : R; (* h; t = h/k, and as a number of f64 *)
  share_of : R; full : R; noise_of : R; own_brake : R; ahead_brake : R; (* the actuator's share, B, n, b = B - n, c *)
  length_ahead : R }.

Definition lag p := step p * (1 - share_of p) / share_of p.
Definition stop_time p := replaced p / own_brake p.

Definition bounds_hold p : Prop :=
  step_within (positions p) (speeds p) (accelerations p) (part p) (part_computed p) /\ part p <= step p /\
  0 < share_of p <= 1 /\ 0 <= noise_of p <= full p /\ full p <= accelerations p /\ 0 <= responses p <= accelerations p /\
  own_brake p = fl (full p - noise_of p) /\ 0 < own_brake p /\ 0 < ahead_brake p <= accelerations p /\ 0 <= replaced p.

Definition state_within p s : Prop :=
  - positions p <= front s <= positions p /\ - positions p <= rear s <= positions p /\
  0 <= own s <= speeds p /\ 0 <= ahead s <= speeds p /\ left_to_lose (full p) (time_left s) (own s) (response_now s) <= replaced p.

(** The new response at the end of a step, with or without lag or delay; the old one holds inside the step. *)
Definition responds p s s' : Prop :=
  s' = s \/
  (time_left s = lag p /\ share_of p = 1 /\ s' = State (front s) (rear s) (own s) (ahead s) (- full p) (lag p + step p)) \/
  (time_left s = lag p /\ - (2 * full p) <= response_now s /\ - responses p <= - full p - response_now s <= responses p /\
   - responses p <= response (full p) (share_of p) (response_now s) <= responses p /\
   s' = State (front s) (rear s) (own s) (ahead s) (responded (share_of p) (response_now s) (- full p)) (lag p + step p)).

Definition moves p s s' : Prop := exists a af,
  part p <= time_left s /\ drives (full p) (noise_of p) (accelerations p) (own s) (response_now s) a /\
  - ahead_brake p <= af <= accelerations p /\
  s' = State (advanced (front s) (ahead s) af (part_computed p)) (advanced (rear s) (own s) a (part_computed p))
    (advanced_speed (own s) a (part_computed p)) (advanced_speed (ahead s) af (part_computed p)) (response_now s) (time_left s - part p).

Definition braking_step p s s'' : Prop := exists s',
  state_within p s /\ responds p s s' /\ state_within p s' /\ moves p s' s'' /\ state_within p s''.

Definition spare_of p s : R :=
  spare (own_brake p) (ahead_brake p) (length_ahead p) (front s) (rear s)
    (left_to_lose (full p) (time_left s) (own s) (response_now s)) (ahead s).

(** At most `step_m` in `MotionBounds::margin_m`. *)
Definition step_loss p : R :=
  u * (8 * positions p + 2 * stop_time p * (speeds p + 6 * accelerations p * step p) + 4 * lag p * stop_time p * responses p).

Theorem a_step_of_full_braking_takes_at_most p s s' : bounds_hold p -> braking_step p s s' -> spare_of p s - step_loss p <= spare_of p s'.
Proof.
  intros [H [Hth [Hs [Hn [HB [HP [Eb [Hb [Hc HZ]]]]]]]]] [s1 [_ [R [[W1 [W2 [W3 [W4 W5]]]] [[a [af [Ht [Hd [Haf ->]]]]] [_ [_ [_ [_ W']]]]]]]]].
  assert (own_brake p <= full p - noise_of p + u * accelerations p) as HbB
    by (rewrite Eb; apply a_brake_less_noise_is_rounded; lra).
  pose proof (motion_takes_at_most _ _ _ _ _ (front s1) (rear s1) (own s1) (ahead s1) (response_now s1) a af (own_brake p) (ahead_brake p)
    (full p) (noise_of p) (time_left s1) (length_ahead p) (replaced p) H W1 W2 W3 W4 Hb ltac:(lra) ltac:(lra) ltac:(lra) HbB Ht Haf Hd W') as M.
  facts. unfold spare_of at 2. simpl in *. fold (stop_time p) in M.
  assert (0 < step p) as Hstep by lra.
  assert (0 <= stop_time p) as HT by (apply Rmult_le_pos; [lra | left; apply Rinv_0_lt_compat; lra]).
  assert (0 <= lag p) as Hl by (unfold lag, Rdiv; repeat apply Rmult_le_pos; [lra | lra | left; apply Rinv_0_lt_compat; lra]).
  assert (0 <= stop_time p * responses p) by (apply Rmult_le_pos; lra).
  assert (0 <= lag p * (stop_time p * responses p)) by (apply Rmult_le_pos; lra).
  assert (accelerations p * part p <= accelerations p * step p) as L1 by (apply Rmult_le_compat_l; lra).
  assert (responses p * step p <= accelerations p * step p) as L2 by (apply Rmult_le_compat_r; lra).
  assert (stop_time p * (accelerations p * part p) <= stop_time p * (accelerations p * step p)) by (apply Rmult_le_compat_l; lra).
  assert (stop_time p * (responses p * step p) <= stop_time p * (accelerations p * step p)) by (apply Rmult_le_compat_l; lra).
  assert (0 <= stop_time p * (responses p * step p)) by (apply Rmult_le_pos; [exact HT | apply Rmult_le_pos; lra]).
  set (motion := 8 * positions p + stop_time p * (2 * speeds p + 8.4 * accelerations p * part p)) in *.
  set (answer := 3.1 * stop_time p * (lag p + step p) * responses p).
  assert (u * (motion + answer) <= step_loss p) as Sum.
  { unfold step_loss. apply Rmult_le_compat_l; [lra |]. unfold motion, answer. lra. }
  assert (0 <= u * answer) by (apply Rmult_le_pos; [lra |]; unfold answer; lra).
  assert (spare_of p s - u * answer <= spare_of p s1) as Resp; [| unfold spare_of at 2 in Resp; lra].
  destruct R as [-> | [[El [E1 ->]] | [El [Hr2 [Hd1 [Hr1 ->]]]]]]; [lra | |]; simpl in *.
  { assert (lag p = 0) as E0 by (unfold lag; rewrite E1; field).
    assert (left_to_lose (full p) (lag p + step p) (own s) (- full p) = left_to_lose (full p) (time_left s) (own s) (response_now s)) as E.
    { unfold left_to_lose. rewrite El, E0, Rplus_opp_l, (Rmax_left 0 0), Rmult_0_r, Rmult_0_l by lra. repeat destruct Rle_dec; lra. }
    unfold spare_of. simpl. rewrite E. lra. }
  pose proof (the_response_takes_at_most (share_of p) (step p) (own s) (response_now s) (full p) (responses p) (ahead s)
    (own_brake p) (ahead_brake p) (front s) (length_ahead p) (rear s) (replaced p) Hs ltac:(lra) ltac:(lra) ltac:(lra) Hb ltac:(lra)
    ltac:(lra) Hr2 Hd1 Hr1) as Q. simpl in Q. fold (lag p) in Q. specialize (Q W5). fold (stop_time p) in Q.
  unfold spare_of. simpl. rewrite El. unfold answer. exact Q.
Qed.

Theorem braking_on_takes_at_most p (s : nat -> state) n : bounds_hold p -> (forall i, (i < n)%nat -> braking_step p (s i) (s (S i))) ->
  spare_of p (s 0%nat) - INR n * step_loss p <= spare_of p (s n).
Proof.
  intros H. induction n as [| n IH]; intros Hs; [simpl; lra |].
  specialize (IH ltac:(intros i Hi; apply Hs; lia)). pose proof (a_step_of_full_braking_takes_at_most p _ _ H (Hs n ltac:(lia))).
  rewrite S_INR. lra.
Qed.

(** * Computed gap and demanded gap *)

(** `PlatoonState::gap_between_m`. *)
Definition seen_gap (xf len x : R) : R := fl (fl (xf - len) - x).

Theorem the_gap_is_seen_rounded X xf len x : - X <= xf <= X -> - X <= xf - len <= X -> - X <= x <= X ->
  - (3.1 * (u * X)) <= seen_gap xf len x - (xf - len - x) <= 3.1 * (u * X).
Proof.
  intros. pose proof u_small. assert (0 <= X) by lra. assert (0 <= u * X) by (apply Rmult_le_pos; lra).
  assert (u * X <= / 1000000 * X) by (apply Rmult_le_compat_r; lra). unfold seen_gap.
  assert (Rabs (xf - len) <= X) as B1 by (apply abs_le; lra). pose proof (fl_within _ _ B1).
  assert (Rabs (fl (xf - len) - x) <= 2.01 * X) as B2 by (apply abs_le; lra). pose proof (fl_within _ _ B2). lra.
Qed.

(** `ViabilityKernel::demanded_gap_m`, operation by operation. *)
Definition stops_computed (b c v w : R) : R := Rmax (fl (fl (fl (v * v) / fl (2 * b)) - fl (fl (w * w) / fl (2 * c)))) 0.
Definition catching_up_computed (b c v w : R) : R :=
  fl (fl (Rmax (fl (v - w)) 0 * Rmax (fl (v - w)) 0) / fl (2 * fl (b - c))).
Definition demanded_computed (b c v w : R) : R :=
  if Rle_dec b c then stops_computed b c v w
  else if Rle_dec (fl (w * b)) (fl (v * c)) then stops_computed b c v w
  else catching_up_computed b c v w.

Lemma Rmax_near x y e : 0 <= e -> - e <= x - y <= e -> - e <= Rmax x 0 - Rmax y 0 <= e.
Proof. intros. unfold Rmax. repeat destruct Rle_dec; lra. Qed.

Lemma stops_near b c v w S : 0 < b -> 0 < c -> v * v / (2 * b) <= S ->
  - (7.8 * (u * S)) <= stops_computed b c v w - Rmax (v * v / (2 * b) - w * w / (2 * c)) 0 <= 7.8 * (u * S).
Proof.
  intros Hb Hc HS. pose proof u_small.
  assert (forall y r, 0 < r -> rel 3.3 (fl (fl (y * y) / fl (2 * r))) (y * y / (2 * r)) /\ 0 <= y * y / (2 * r)) as Q.
  { intros y r Hr. split.
    - apply (rel_weaken (1.1 + 1.1 + / 100 + 1 + / 1000)); [lra |]. apply rel_fl; [lra |].
      apply rel_div; try lra; (apply (rel_weaken (0 + 1 + / 1000)); [lra |]; apply rel_fl; [lra | apply rel_refl]).
    - apply Rmult_le_pos; [nra | left; apply Rinv_0_lt_compat; lra]. }
  destruct (Q v b Hb) as [[d [Hd E1]] N1]. destruct (Q w c Hc) as [[d' [Hd' E2]] N2]. apply of_abs in Hd, Hd'.
  unfold stops_computed. rewrite E1, E2. set (S1 := v * v / (2 * b)) in *. set (S2 := w * w / (2 * c)) in *.
  assert (0 <= u * S) by (apply Rmult_le_pos; lra). assert (u * S <= / 1000000 * S) by (apply Rmult_le_compat_r; lra).
  assert (- (3.3 * (u * S)) <= S1 * d <= 3.3 * (u * S)).
  { apply of_abs. rewrite Rabs_mult, (Rabs_right S1) by lra. replace (3.3 * (u * S)) with (S * (3.3 * u)) by ring.
    apply Rmult_le_compat; try lra; [apply Rabs_pos | apply abs_le; lra]. }
  destruct (Rle_lt_dec S2 (1.001 * S1)) as [L | L].
  - assert (- (3.31 * (u * S)) <= S2 * d' <= 3.31 * (u * S)).
    { apply of_abs. rewrite Rabs_mult, (Rabs_right S2) by lra.
      apply Rle_trans with ((1.001 * S) * (3.3 * u)); [| lra]. apply Rmult_le_compat; try lra; [apply Rabs_pos | apply abs_le; lra]. }
    apply Rmax_near; [lra |].
    assert (Rabs (S1 * (1 + d) - S2 * (1 + d')) <= 1.01 * S) as B by (apply abs_le; lra). pose proof (fl_within _ _ B). lra.
  - assert (S2 * d' >= - / 10000 * S2). { assert (0 <= S2 * (/ 10000 + d')) by (apply Rmult_le_pos; lra). lra. }
    assert (S1 * d <= / 10000 * S1). { assert (0 <= S1 * (/ 10000 - d)) by (apply Rmult_le_pos; lra). lra. }
    pose proof (fl_negative (S1 * (1 + d) - S2 * (1 + d')) ltac:(lra)). rewrite !Rmax_right by lra. lra.
Qed.

Lemma catching_up_is_less b c v w : 0 < c < b -> 0 <= w <= v -> v * c <= w * b -> (v - w) * (v - w) / (2 * (b - c)) <= v * v / (2 * b).
Proof.
  intros Hc Hw H. apply (Rmult_le_reg_r (2 * b * (b - c))); [apply Rmult_lt_0_compat; lra |].
  replace ((v - w) * (v - w) / (2 * (b - c)) * (2 * b * (b - c))) with (b * (v - w) * (v - w)) by (field; lra).
  replace (v * v / (2 * b) * (2 * b * (b - c))) with (v * (v * (b - c))) by (field; lra).
  assert (0 <= v * (b - c) - b * (v - w)) by lra.
  assert (b * (v - w) * (v - w) <= v * (b - c) * (v - w)) by (apply Rmult_le_compat_r; lra).
  assert (v * (b - c) * (v - w) <= v * (b - c) * v) by (apply Rmult_le_compat_l; [apply Rmult_le_pos; lra | lra]). lra.
Qed.

(** Two different limits differ by at least a share u. *)
Theorem limits_are_the_same_or_apart b c : generic_format radix2 (FLX_exp 53) b -> generic_format radix2 (FLX_exp 53) c -> 0 < c < b ->
  u * c <= b - c.
Proof.
  intros Fb Fc H. pose proof (succ_le_lt radix2 (FLX_exp 53) c b Fc Fb ltac:(lra)) as S. rewrite succ_eq_pos in S by lra.
  pose proof (ulp_FLX_ge radix2 53 c) as G. rewrite Rabs_right in G by lra.
  assert (u = bpow radix2 (- 53)) as E. { Transparent u. unfold u. simpl. lra. }
  assert (u * c <= ulp radix2 (FLX_exp 53) c) by (rewrite E, Rmult_comm; exact G). lra.
Qed.
Opaque u.

(** Up to the largest stopping distance, S. *)
Theorem the_demand_is_rounded b c v w S : 0 < b -> 0 < c -> (b <= c \/ u * c <= b - c) -> 0 <= v -> 0 <= w -> v * v / (2 * b) <= S ->
  - (12 * (u * S)) <= demanded_computed b c v w - D b c v w <= 12 * (u * S).
Proof.
  intros Hb Hc Hapart Hv Hw HS. pose proof u_small.
  assert (0 <= v * v / (2 * b)) by (apply Rmult_le_pos; [nra | left; apply Rinv_0_lt_compat; lra]).
  assert (0 <= u * S) by (apply Rmult_le_pos; lra).
  pose proof (stops_near b c v w S Hb Hc HS) as St. unfold demanded_computed, D.
  destruct (Rle_dec b c) as [N | N]; [lra |]. apply Rnot_le_lt in N. destruct Hapart as [L | Hap]; [lra |].
  destruct (Rle_dec (w * b) (v * c)) as [M | M].
  - destruct (Rle_dec (fl (w * b)) (fl (v * c))) as [F | F]; [lra |]. destruct F. apply fl_monotone, M.
  - apply Rnot_le_lt in M. destruct (Rle_dec (fl (w * b)) (fl (v * c))) as [F | F].
    + (* wrong branch: nearly equal values *)
      destruct (Rle_lt_dec v w) as [L | L].
      * rewrite (Rmax_right (v - w) 0) by lra. rewrite Rmult_0_l. unfold Rdiv at 1. rewrite Rmult_0_l.
        assert (v * v / (2 * b) <= w * w / (2 * c)) as LL.
        { apply Rle_trans with (w * w / (2 * b)); [apply Rmult_le_compat_r; [left; apply Rinv_0_lt_compat; lra | nra] |].
          apply Rmult_le_compat_l; [nra |]. apply Rinv_le_contravar; lra. }
        rewrite (Rmax_right (v * v / (2 * b) - w * w / (2 * c)) 0) in St by lra. lra.
      * rewrite (Rmax_left (v - w) 0) by lra.
        set (q := w * b - v * c). assert (0 <= v * c) by (apply Rmult_le_pos; lra).
        assert (0 < q <= 2.01 * (u * (v * c))) as Hq.
        { destruct (fl_is (w * b)) as [d [Hd E1]]. destruct (fl_is (v * c)) as [d' [Hd' E2]]. rewrite E1, E2 in F. apply of_abs in Hd, Hd'.
          assert (w * b * (1 - u) <= w * b * (1 + d)) by (apply Rmult_le_compat_l; [apply Rmult_le_pos |]; lra).
          assert (v * c * (1 + d') <= v * c * (1 + u)) by (apply Rmult_le_compat_l; lra).
          assert ((w * b - v * c) * (1 - u) <= 2 * (u * (v * c))) by lra.
          assert (0 <= u * (v * c)) by (apply Rmult_le_pos; lra).
          split; [unfold q; lra |]. unfold q.
          apply (Rmult_le_reg_r (1 - u)); [lra |].
          assert (2.01 * (u * (v * c)) * u <= 2.01 * (u * (v * c)) * / 1000000) by (apply Rmult_le_compat_l; lra). lra. }
        assert (v * v / (2 * b) - w * w / (2 * c) = (v - w) * (v - w) / (2 * (b - c)) - q * q / (2 * b * c * (b - c))) as E
          by (unfold q; field; lra).
        assert (0 <= q * q / (2 * b * c * (b - c)) <= 4.1 * (u * S)) as Hex.
        { assert (0 < 2 * b * c * (b - c)) by (repeat apply Rmult_lt_0_compat; lra).
          split; [apply Rmult_le_pos; [nra | left; apply Rinv_0_lt_compat; lra] |].
          apply Rle_trans with (4.1 * (u * (v * v / (2 * b)))); [| assert (u * (v * v / (2 * b)) <= u * S) by (apply Rmult_le_compat_l; lra); lra].
          apply (Rmult_le_reg_r (2 * b * c * (b - c))); [assumption |].
          replace (q * q / (2 * b * c * (b - c)) * (2 * b * c * (b - c))) with (q * q) by (field; lra).
          replace (4.1 * (u * (v * v / (2 * b))) * (2 * b * c * (b - c))) with (4.1 * u * (v * v * c) * (b - c)) by (field; lra).
          assert (q * q <= (2.01 * (u * (v * c))) * (2.01 * (u * (v * c)))) by (apply Rmult_le_compat; lra).
          assert (0 <= v * v * c) by (apply Rmult_le_pos; [apply Rmult_le_pos |]; lra).
          assert (0 <= 4.1 * u * (v * v * c)) by (apply Rmult_le_pos; [lra | assumption]).
          assert (4.1 * u * (v * v * c) * (u * c) <= 4.1 * u * (v * v * c) * (b - c)) by (apply Rmult_le_compat_l; lra).
          assert (0 <= (u * (v * c)) * (u * (v * c))) by (apply Rmult_le_pos; apply Rmult_le_pos; lra). lra. }
        assert (0 <= (v - w) * (v - w) / (2 * (b - c))) by (apply Rmult_le_pos; [nra | left; apply Rinv_0_lt_compat; lra]).
        pose proof (Rmax_near (v * v / (2 * b) - w * w / (2 * c)) ((v - w) * (v - w) / (2 * (b - c))) (4.1 * (u * S)) ltac:(lra) ltac:(lra)) as Mx.
        rewrite (Rmax_left ((v - w) * (v - w) / (2 * (b - c))) 0) in Mx by lra. lra.
    + (* catching up *)
      unfold catching_up_computed. destruct (Rle_lt_dec v w) as [L | L].
      * assert (fl (v - w) <= 0) by (rewrite <- fl_0; apply fl_monotone; lra).
        rewrite !(Rmax_right _ 0) by lra. rewrite Rmult_0_l, fl_0. unfold Rdiv. rewrite !Rmult_0_l, fl_0. lra.
      * assert (0 <= fl (v - w)) by (rewrite <- fl_0; apply fl_monotone; lra).
        rewrite !(Rmax_left _ 0) by lra.
        pose proof (catching_up_is_less b c v w ltac:(lra) ltac:(lra) ltac:(lra)) as Less.
        assert (0 <= (v - w) * (v - w) / (2 * (b - c))) by (apply Rmult_le_pos; [nra | left; apply Rinv_0_lt_compat; lra]).
        assert (forall y, rel 1.1 (fl y) y) as R1 by (intros; apply (rel_weaken (0 + 1 + / 1000)); [lra |]; apply rel_fl; [lra | apply rel_refl]).
        assert (rel 7 (fl (fl (fl (v - w) * fl (v - w)) / fl (2 * fl (b - c)))) ((v - w) * (v - w) / (2 * (b - c)))) as R7.
        { apply (rel_weaken (3.3 + 2.2 + / 100 + 1 + / 1000)); [lra |]. apply rel_fl; [lra |]. apply rel_div; try lra.
          - apply (rel_weaken (1.1 + 1.1 + / 1000 + 1 + / 1000)); [lra |]. apply rel_fl; [lra |]. apply rel_mul; auto; lra.
          - apply (rel_weaken (0 + 1.1 + / 1000 + 1 + / 1000)); [lra |]. apply rel_fl; [lra |]. apply rel_mul; auto using rel_refl; lra. }
        assert (Rabs ((v - w) * (v - w) / (2 * (b - c))) <= S) as B by (apply abs_le; lra).
        pose proof (rel_bounds 7 _ _ _ ltac:(lra) R7 B). lra.
Qed.
(** * The test *)

(** `ShieldParams::lag_s` and `ShieldParams::speed_to_lose_mps`, operation by operation. *)
Definition lag_computed (h share : R) : R := fl (fl (h * fl (1 - share)) / share).
Definition to_lose_computed (B h share v r : R) : R :=
  let moving := fl (v + fl (lag_computed h share * fl (r + B))) in
  if Rle_dec v 0 then if Rle_dec r 0 then 0 else moving else moving.

(** A response may have been rounded to a little less than -B. *)
Theorem the_speed_to_lose_is_rounded B h share v r P Z : 0 < share <= 1 -> 0 < h -> 0 <= v -> - (3.1 * (u * P)) <= r + B <= P ->
  let tau := h * (1 - share) / share in
  left_to_lose B tau v r <= Z ->
  - (7 * (u * Z) + 4 * (u * (tau * P))) <= to_lose_computed B h share v r - left_to_lose B tau v r <= 7 * (u * Z) + 4 * (u * (tau * P)).
Proof.
  intros Hs Hh Hv Hr tau HZ. pose proof u_small.
  assert (0 <= tau) as Ht. { unfold tau, Rdiv. apply Rmult_le_pos; [apply Rmult_le_pos; lra | left; apply Rinv_0_lt_compat; lra]. }
  assert (0 <= P).
  { apply Rnot_lt_le. intros N.
    assert (0 < u * - P <= / 1000000 * - P) by (split; [apply Rmult_lt_0_compat | apply Rmult_le_compat_r]; lra). lra. }
  assert (0 <= tau * P) by (apply Rmult_le_pos; lra). assert (0 <= u * (tau * P)) by (apply Rmult_le_pos; lra).
  assert (u * (u * (tau * P)) <= / 1000000 * (u * (tau * P))) by (apply Rmult_le_compat_r; lra).
  pose proof (left_to_lose_nonneg B tau v r Ht Hv) as Hz. assert (0 <= u * Z) by (apply Rmult_le_pos; lra).
  assert (forall y, rel 1.1 (fl y) y) as R1 by (intros; apply (rel_weaken (0 + 1 + / 1000)); [lra |]; apply rel_fl; [lra | apply rel_refl]).
  assert (rel 3.3 (lag_computed h share) tau) as R3.
  { unfold lag_computed, tau. apply (rel_weaken (2.2 + 0 + / 100 + 1 + / 1000)); [lra |]. apply rel_fl; [lra |].
    apply rel_div; try lra; [| apply rel_refl]. apply (rel_weaken (0 + 1.1 + / 1000 + 1 + / 1000)); [lra |]. apply rel_fl; [lra |].
    apply rel_mul; auto using rel_refl; lra. }
  assert (rel 5.5 (fl (lag_computed h share * fl (r + B))) (tau * (r + B))) as R5.
  { apply (rel_weaken (3.3 + 1.1 + / 1000 + 1 + / 1000)); [lra |]. apply rel_fl; [lra |]. apply rel_mul; auto; lra. }
  destruct R5 as [d [Hd E]]. apply of_abs in Hd.
  assert (left_to_lose B tau v r = v + tau * Rmax (r + B) 0 ->
    - (7 * (u * Z) + 4 * (u * (tau * P))) <= fl (v + fl (lag_computed h share * fl (r + B))) - (v + tau * Rmax (r + B) 0)
      <= 7 * (u * Z) + 4 * (u * (tau * P))) as Moving.
  { intros Ez. rewrite E. rewrite Ez in HZ. destruct (Rle_lt_dec 0 (r + B)) as [G | G].
    - rewrite (Rmax_left (r + B) 0) in * by lra. assert (0 <= tau * (r + B)) by (apply Rmult_le_pos; lra).
      assert (- (5.5 * (u * Z)) <= tau * (r + B) * d <= 5.5 * (u * Z)).
      { apply of_abs. rewrite Rabs_mult, (Rabs_right (tau * (r + B))) by lra.
        apply Rle_trans with (Z * (5.5 * u)); [| lra]. apply Rmult_le_compat; try lra; [apply Rabs_pos | apply abs_le; lra]. }
      assert (u * Z <= / 1000000 * Z) by (apply Rmult_le_compat_r; lra).
      assert (Rabs (v + tau * (r + B) * (1 + d)) <= 1.001 * Z) as Bd by (apply abs_le; lra). pose proof (fl_within _ _ Bd). lra.
    - rewrite (Rmax_right (r + B) 0) in * by lra.
      assert (tau * - (r + B) <= tau * (3.1 * (u * P))) by (apply Rmult_le_compat_l; lra).
      assert (0 <= tau * - (r + B)) by (apply Rmult_le_pos; lra).
      assert (- / 10000 * (tau * - (r + B)) <= tau * - (r + B) * d <= / 10000 * (tau * - (r + B))).
      { assert (0 <= tau * - (r + B) * (/ 10000 - d)) by (apply Rmult_le_pos; lra).
        assert (0 <= tau * - (r + B) * (/ 10000 + d)) by (apply Rmult_le_pos; lra). lra. }
      assert (Rabs (v + tau * (r + B) * (1 + d)) <= Z + 3.2 * (u * (tau * P))) as Bd by (apply abs_le; lra).
      pose proof (fl_within _ _ Bd). lra. }
  unfold to_lose_computed, left_to_lose in *. destruct (Rle_dec v 0); [destruct (Rle_dec r 0); [lra |] |]; auto.
Qed.

(** `ShieldParams::spare_m` of the stored state, as computed. *)
Definition spare_computed (b c B h share len xf x v r w : R) : R :=
  fl (seen_gap xf len x - demanded_computed b c (to_lose_computed B h share v r) w).

Theorem what_is_demanded_is_rounded b c B h share v r w P Z : 0 < b -> 0 < c -> (b <= c \/ u * c <= b - c) -> 0 <= v -> 0 <= w ->
  0 < share <= 1 -> 0 < h -> - (3.1 * (u * P)) <= r + B <= P -> 0 <= to_lose_computed B h share v r ->
  let tau := h * (1 - share) / share in
  let S := Z * Z / (2 * b) in
  let demanded := demanded_computed b c (to_lose_computed B h share v r) w in
  let e := u * (26.9 * S + 4.01 * tau * (Z / b) * P) in
  tau * P <= Z -> left_to_lose B tau v r <= Z ->
  - e <= demanded - D b c (left_to_lose B tau v r) w <= e /\ Rabs demanded <= 1.01 * S.
Proof.
  intros Hb Hc Hap Hv Hw Hs Hh Hr Hzc tau S demanded e' HtP HZ. pose proof u_small.
  pose proof (the_speed_to_lose_is_rounded B h share v r P Z Hs Hh Hv Hr HZ) as E. fold tau in E.
  assert (0 <= tau) as Ht. { unfold tau, Rdiv. apply Rmult_le_pos; [apply Rmult_le_pos; lra | left; apply Rinv_0_lt_compat; lra]. }
  assert (0 <= P).
  { apply Rnot_lt_le. intros N.
    assert (0 < u * - P <= / 1000000 * - P) by (split; [apply Rmult_lt_0_compat | apply Rmult_le_compat_r]; lra). lra. }
  assert (0 <= tau * P) by (apply Rmult_le_pos; lra).
  pose proof (left_to_lose_nonneg B tau v r Ht Hv) as Hz. set (z := left_to_lose B tau v r) in *.
  unfold demanded in *. clear demanded. set (zc := to_lose_computed B h share v r) in *.
  assert (0 <= Z) by lra. assert (0 <= u * Z) by (apply Rmult_le_pos; lra). assert (u * Z <= / 1000000 * Z) by (apply Rmult_le_compat_r; lra).
  assert (0 <= u * (tau * P) <= u * Z) by (split; [apply Rmult_le_pos | apply Rmult_le_compat_l]; lra).
  assert (0 < / b) as Hib by (apply Rinv_0_lt_compat; lra).
  set (T := Z / b) in *.
  assert (T * (u * Z) = 2 * (u * S)) as ETS by (unfold T, S; field; lra).
  assert (0 <= T) by (unfold T; apply Rmult_le_pos; lra).
  assert (0 <= S) by (unfold S; apply Rmult_le_pos; [nra | left; apply Rinv_0_lt_compat; lra]).
  assert (0 <= u * S) by (apply Rmult_le_pos; lra). assert (u * S <= / 1000000 * S) by (apply Rmult_le_compat_r; lra).
  assert (0 <= T * (u * (tau * P)) <= T * (u * Z)) by (split; [apply Rmult_le_pos | apply Rmult_le_compat_l]; lra).
  set (e := 7 * (u * Z) + 4 * (u * (tau * P))) in *. assert (0 <= e) by (unfold e; lra).
  assert (zc <= 1.001 * Z) as Hzc' by (unfold e in E; lra).
  assert (forall z1 z2, 0 <= z1 <= 1.001 * Z -> 0 <= z2 -> z1 <= z2 + e -> D b c z1 w <= D b c z2 w + 1.001 * T * e) as Lip.
  { intros z1 z2 G1 G2 G12.
    pose proof (the_demand_rises_with_errors_of_speeds b c z2 w z1 w e Hb Hc G2 Hw ltac:(lra) Hw 0 ltac:(lra) ltac:(lra) G12 ltac:(lra)) as M.
    assert (z1 / b <= 1.001 * Z / b) as Q by (apply Rmult_le_compat_r; lra).
    assert (z1 / b * (e + 0) <= 1.001 * Z / b * e) by (rewrite Rplus_0_r; apply Rmult_le_compat_r; lra).
    assert (1.001 * Z / b * e = 1.001 * T * e) by (unfold T; field; lra). lra. }
  pose proof (Lip zc z ltac:(lra) Hz ltac:(lra)) as L1. pose proof (Lip z zc ltac:(lra) Hzc ltac:(lra)) as L2.
  assert (1.001 * T * e <= 14.1 * (u * S) + 4.01 * (T * (u * (tau * P)))) as Le by (unfold e; lra).
  assert (zc * zc / (2 * b) <= 1.003 * S) as HS.
  { apply Rle_trans with ((1.001 * Z) * (1.001 * Z) / (2 * b)).
    - apply Rmult_le_compat_r; [left; apply Rinv_0_lt_compat; lra |]. apply Rmult_le_compat; lra.
    - unfold S, Rdiv in *. lra. }
  pose proof (the_demand_is_rounded b c zc w (1.003 * S) Hb Hc Hap Hzc Hw HS) as Dr.
  assert (0 <= D b c zc w <= 1.003 * S) as HD.
  { split.
    - pose proof (demanded_is_enough b c zc w 0 Hb Hc Hzc Hw ltac:(lra)) as N. unfold closing in N. rewrite !covered_nothing in N by lra. lra.
    - destruct (demanded_is_needed b c zc w Hb Hc Hzc Hw) as [i [Hi <-]]. unfold closing.
      pose proof (covered_at_most zc b i Hb). pose proof (covered_at_least w c 0 i Hc ltac:(lra)). lra. }
  set (dc := demanded_computed b c zc w) in *.
  assert (e' = 26.9 * (u * S) + 4.01 * (T * (u * (tau * P)))) as -> by (unfold e'; lra).
  split; [lra |]. apply abs_le. lra.
Qed.

Lemma spare_terms tau Z b P u' : 0 <= tau -> 0 < b -> - (3.1 * (u' * P)) <= P -> 0 < u' <= / 1000000 -> tau * P <= Z -> 0 <= Z -> 0 <= tau * (Z / b) * P.
Proof.
  intros. assert (0 <= P). { apply Rnot_lt_le. intros N. assert (0 <= u' * - P) by (apply Rmult_le_pos; lra). lra. }
  assert (0 <= Z / b) by (apply Rmult_le_pos; [lra | left; apply Rinv_0_lt_compat; lra]). apply Rmult_le_pos; [apply Rmult_le_pos |]; lra.
Qed.

Theorem the_spare_gap_is_rounded X b c B h share len xf x v r w P Z :
  - X <= xf <= X -> - X <= xf - len <= X -> - X <= x <= X -> 0 < b -> 0 < c -> (b <= c \/ u * c <= b - c) -> 0 <= v -> 0 <= w ->
  0 < share <= 1 -> 0 < h -> - (3.1 * (u * P)) <= r + B <= P -> 0 <= to_lose_computed B h share v r ->
  let tau := h * (1 - share) / share in
  tau * P <= Z -> left_to_lose B tau v r <= Z ->
  let eta := u * (6 * X + 28 * (Z * Z / (2 * b)) + 4.1 * tau * (Z / b) * P) in
  - eta <= spare_computed b c B h share len xf x v r w - spare b c len xf x (left_to_lose B tau v r) w <= eta.
Proof.
  intros Hxf Hxl Hx Hb Hc Hap Hv Hw Hs Hh Hr Hzc tau HtP HZ eta. pose proof u_small.
  destruct (what_is_demanded_is_rounded b c B h share v r w P Z Hb Hc Hap Hv Hw Hs Hh Hr Hzc HtP HZ) as [E Bd]. fold tau in E.
  pose proof (the_gap_is_seen_rounded X xf len x Hxf Hxl Hx) as G. unfold spare_computed, spare.
  set (dc := demanded_computed b c (to_lose_computed B h share v r) w) in *. set (g := seen_gap xf len x) in *.
  assert (0 <= X) by lra. assert (0 <= u * X) by (apply Rmult_le_pos; lra). assert (u * X <= / 1000000 * X) by (apply Rmult_le_compat_r; lra).
  assert (0 <= tau) as Ht. { unfold tau, Rdiv. apply Rmult_le_pos; [apply Rmult_le_pos; lra | left; apply Rinv_0_lt_compat; lra]. }
  pose proof (left_to_lose_nonneg B tau v r Ht Hv). apply of_abs in Bd. set (S := Z * Z / (2 * b)) in *.
  assert (Rabs (g - dc) <= 2.01 * X + 1.01 * S) as Bg by (apply abs_le; lra). pose proof (fl_within _ _ Bg).
  assert (0 <= u * (tau * (Z / b) * P)).
  { apply Rmult_le_pos; [lra |]. apply (spare_terms tau Z b P u); lra. }
  unfold eta. lra.
Qed.

(** The test of an action after the predicted steps, with a gap at most e better than the later one, and speeds no better. *)
Theorem what_passes_the_test_is_spare X b c B h share gap xf len x v v' r w w' m e P Z :
  - (3 * X) <= gap <= 3 * X -> 0 < b -> 0 < c -> (b <= c \/ u * c <= b - c) -> 0 <= v <= v' -> 0 <= w' <= w ->
  0 < share <= 1 -> 0 < h -> - (3.1 * (u * P)) <= r + B <= P -> 0 <= to_lose_computed B h share v' r ->
  let tau := h * (1 - share) / share in
  tau * P <= Z -> left_to_lose B tau v' r <= Z -> gap <= xf - len - x + e ->
  m <= fl (gap - demanded_computed b c (to_lose_computed B h share v' r) w') ->
  m - e - u * (3 * X + 28 * (Z * Z / (2 * b)) + 4.1 * tau * (Z / b) * P) <= spare b c len xf x (left_to_lose B tau v r) w.
Proof.
  intros Hg Hb Hc Hap Hv Hw Hs Hh Hr Hzc tau HtP HZ He Hm. pose proof u_small.
  destruct (what_is_demanded_is_rounded b c B h share v' r w' P Z Hb Hc Hap ltac:(lra) ltac:(lra) Hs Hh Hr Hzc HtP HZ) as [E Bd]. fold tau in E.
  unfold spare. set (dc := demanded_computed b c (to_lose_computed B h share v' r) w') in *.
  assert (0 <= X) by lra. apply of_abs in Bd. set (S := Z * Z / (2 * b)) in *.
  assert (Rabs (gap - dc) <= 3 * X + 1.01 * S) as Bg by (apply abs_le; lra). pose proof (fl_within _ _ Bg).
  assert (0 <= tau) as Ht. { unfold tau, Rdiv. apply Rmult_le_pos; [apply Rmult_le_pos; lra | left; apply Rinv_0_lt_compat; lra]. }
  pose proof (left_to_lose_nonneg B tau v r Ht ltac:(lra)) as Hz. pose proof (left_to_lose_nonneg B tau v' r Ht ltac:(lra)) as Hz'.
  assert (0 <= u * (tau * (Z / b) * P)).
  { apply Rmult_le_pos; [lra |]. apply (spare_terms tau Z b P u); lra. }
  assert (left_to_lose B tau v r <= left_to_lose B tau v' r) as L.
  { unfold left_to_lose. assert (0 <= tau * Rmax (r + B) 0) by (apply Rmult_le_pos; [lra | apply Rmax_r]).
    destruct (Rle_dec v 0); destruct (Rle_dec v' 0); destruct (Rle_dec r 0); lra. }
  pose proof (demand_rises_with_the_own_speed b c _ _ w Hb Hc (conj Hz L) ltac:(lra)).
  pose proof (demand_falls_with_the_speed_ahead b c (left_to_lose B tau v' r) w' w Hb Hc ltac:(lra) ltac:(lra)). lra.
Qed.

(** * Inside a step *)

Lemma moved_at_least w a c t : 0 < c -> 0 <= w -> - c <= a -> 0 <= t -> covered w c t <= moved w a t.
Proof.
  intros Hc Hw Ha Ht. unfold moved. destruct (Rle_dec 0 (w + a * t)) as [M | M].
  - destruct (covered_is w c t Hc Hw Ht) as [s [Hs [Hcs ->]]].
    assert (- c * (s * s) <= a * (s * s)) by (apply Rmult_le_compat_r; nra).
    assert (0 <= (t - s) * (w + a * t + (w - c * s))) by (apply Rmult_le_pos; lra).
    assert (0 <= (t - s) * (s * (a + c))) by (repeat apply Rmult_le_pos; lra). lra.
  - assert (a < 0). { apply Rnot_le_lt. intros N. apply M. assert (0 <= a * t) by (apply Rmult_le_pos; lra). lra. }
    apply Rle_trans with (1 := covered_at_most w c t Hc). apply (Rmult_le_compat_l (w * w)); [nra |]. apply Rinv_le_contravar; lra.
Qed.

(** At every instant of a step from the stored numbers, in real arithmetic. *)
Theorem inside_a_step_nobody_touches p s a af t : bounds_hold p -> state_within p s -> 0 <= t <= part p -> part p <= time_left s ->
  drives (full p) (noise_of p) (accelerations p) (own s) (response_now s) a -> - ahead_brake p <= af <= accelerations p ->
  spare_of p s - u * positions p <=
  (front s + moved (ahead s) af t) - length_ahead p - (rear s + moved (own s) a t).
Proof.
  intros [H [Hth [_ [Hn [HB [_ [Eb [Hb [Hc _]]]]]]]]] [_ [_ [W3 [W4 _]]]] Ht Hleft [Ha [Hab Hheld]] Haf.
  assert (own_brake p <= full p - noise_of p + u * accelerations p) as HbB
    by (rewrite Eb; apply a_brake_less_noise_is_rounded; lra).
  facts. pose proof (moved_at_least (ahead s) af (ahead_brake p) t ltac:(lra) ltac:(lra) ltac:(lra) ltac:(lra)) as F.
  pose proof (left_to_lose_nonneg (full p) (time_left s) (own s) (response_now s) ltac:(lra) ltac:(lra)) as Hz.
  set (z := left_to_lose (full p) (time_left s) (own s) (response_now s)) in *.
  pose proof (demanded_is_enough (own_brake p) (ahead_brake p) z (ahead s) t Hb ltac:(lra) Hz ltac:(lra) ltac:(lra)) as En.
  unfold closing in En.
  assert (0 <= covered z (own_brake p) t) as Hcov.
  { pose proof (covered_at_least z (own_brake p) 0 t Hb ltac:(lra)). lra. }
  assert (t * t <= part p * part p) as Htt by (apply Rmult_le_compat; lra).
  assert (accelerations p * (t * t) <= accelerations p * (part p * part p)) as HA by (apply Rmult_le_compat_l; lra).
  assert (u * (accelerations p * (t * t)) <= u * (accelerations p * (part p * part p))) by (apply Rmult_le_compat_l; lra).
  assert (moved (own s) a t <= covered z (own_brake p) t + u * positions p) as O; [| unfold spare_of, spare; fold z; lra].
  destruct (Rle_dec (own s) 0) as [S | S]; [destruct (Rle_dec (response_now s) 0) as [S' | S'] |].
  { specialize (Hheld S S'). assert (own s = 0) as E0 by lra. rewrite E0. unfold moved. destruct Rle_dec as [M | M].
    - assert (a * (t * t) <= 0) by nra. lra.
    - replace (0 * 0 / (-2 * a)) with 0; [lra |]. unfold Rdiv. ring. }
  all: assert (~ (own s <= 0 /\ response_now s <= 0)) as N by tauto.
  all: pose proof (fun i Hi => own_way (full p) (noise_of p) (accelerations p) (time_left s) (own s) (response_now s) a (own_brake p) i Hb
    ltac:(lra) HbB Hi ltac:(lra) Hab N) as W; fold z in W.
  all: unfold moved; destruct (Rle_dec 0 (own s + a * t)) as [M | M]; [specialize (W t ltac:(lra)); lra |].
  all: assert (a < 0) by (apply Rnot_le_lt; intros G; apply M; assert (0 <= a * t) by (apply Rmult_le_pos; lra); lra).
  all: destruct (half_square (own s) (- a) ltac:(lra)) as [i [Ei Ew]];
    replace (own s * own s / (-2 * a)) with (own s * own s / (2 * - a)) by (field; lra); rewrite Ew.
  all: assert (0 <= i <= t) as Hi by (split; apply Rnot_lt_le; intros G; [assert (0 < - a * - i) by (apply Rmult_lt_0_compat; lra); lra
    | apply M; assert (0 < - a * (i - t)) by (apply Rmult_lt_0_compat; lra); lra]).
  all: specialize (W i ltac:(lra)); assert (own s * i = - a * i * i) as Ei2 by (rewrite Ei at 1; ring).
  all: pose proof (covered_rises z (own_brake p) i t Hb Hz Hi).
  all: assert (i * i <= part p * part p) by (apply Rmult_le_compat; lra).
  all: assert (accelerations p * (i * i) <= accelerations p * (part p * part p)) by (apply Rmult_le_compat_l; lra).
  all: assert (u * (accelerations p * (i * i)) <= u * (accelerations p * (part p * part p))) by (apply Rmult_le_compat_l; lra).
  all: lra.
Qed.

(** * Predicted steps *)

Lemma moved_is v a t : 0 <= v -> 0 <= t -> exists s, 0 <= s <= t /\ moved v a t = v * s + a * s * s / 2.
Proof.
  intros Hv Ht. unfold moved. destruct (Rle_dec 0 (v + a * t)) as [M | M]; [exists t; lra |].
  assert (a < 0). { apply Rnot_le_lt. intros N. apply M. assert (0 <= a * t) by (apply Rmult_le_pos; lra). lra. }
  destruct (half_square v (- a) ltac:(lra)) as [s [Es Ew]]. exists s. split.
  - split; apply Rnot_lt_le; intros N; [assert (0 < - a * - s) by (apply Rmult_lt_0_compat; lra); lra |].
    apply M. assert (0 < - a * (s - t)) by (apply Rmult_lt_0_compat; lra). lra.
  - replace (v * v / (-2 * a)) with (v * v / (2 * - a)) by (field; lra). rewrite Ew. rewrite Es at 1. field.
Qed.

Lemma moved_reaches v a s t : 0 <= v -> 0 <= s <= t -> v * s + a * s * s / 2 <= moved v a t.
Proof.
  intros Hv Hs. unfold moved. destruct (Rle_dec 0 (v + a * t)) as [M | M].
  - assert (0 <= v + a * ((t + s) / 2)).
    { destruct (Rle_lt_dec 0 a) as [G | G]; [assert (0 <= a * ((t + s) / 2)) by (apply Rmult_le_pos; lra); lra |].
      assert (0 <= - a * (t - (t + s) / 2)) by (apply Rmult_le_pos; lra). lra. }
    assert (0 <= (t - s) * (v + a * ((t + s) / 2))) by (apply Rmult_le_pos; lra). lra.
  - assert (a < 0). { apply Rnot_le_lt. intros N. apply M. assert (0 <= a * t) by (apply Rmult_le_pos; lra). lra. }
    pose proof (peak v (- a) s ltac:(lra)). replace (v * v / (-2 * a)) with (v * v / (2 * - a)) by (field; lra). lra.
Qed.

Lemma moved_increases v v' a a' t : 0 <= v <= v' -> a <= a' -> 0 <= t -> moved v a t <= moved v' a' t.
Proof.
  intros Hv Ha Ht. destruct (moved_is v a t) as [s [Hs ->]]; try lra.
  apply Rle_trans with (v' * s + a' * s * s / 2); [| apply moved_reaches; lra].
  assert (v * s <= v' * s) by (apply Rmult_le_compat_r; lra). assert (a * (s * s) <= a' * (s * s)) by (apply Rmult_le_compat_r; nra). lra.
Qed.

(** A position after a step, whichever branch is taken. *)
Theorem a_position_is_rounded X V A t dt x v a : step_within X V A t dt -> - X <= x <= X -> 0 <= v <= V -> - A <= a <= A ->
  - (4 * (u * X)) <= advanced x v a dt - (x + moved v a t) <= 4 * (u * X).
Proof.
  intros H Hx Hv Ha. unfold advanced. destruct (Rlt_dec (end_speed v a dt) 0) as [S | S].
  - destruct (stopping _ _ _ _ _ x _ _ H Hx Hv Ha S) as [Hn [Hs E]]. facts.
    assert (moved v a t <= v * v / (-2 * a)).
    { destruct (moved_is v a t) as [s [Hs' ->]]; try lra. pose proof (peak v (- a) s ltac:(lra)).
      replace (v * v / (-2 * a)) with (v * v / (2 * - a)) by (field; lra). lra. }
    assert (v * v / (-2 * a) <= moved v a t + 2 * (u * (A * t * t))); [| lra].
    apply (stopped_way A v a t (fun s => moved v a s)); try lra.

    + intros s Hs'. pose proof (moved_reaches v a s s ltac:(lra) ltac:(lra)).
      assert (0 <= u * (A * s * s)) by (apply Rmult_le_pos; [lra |]; apply Rmult_le_pos; [apply Rmult_le_pos |]; lra). lra.
    + intros s Hs'. destruct (moved_is v a s) as [i [Hi ->]]; try lra. apply moved_reaches; lra.
  - pose proof (way_near _ _ _ _ _ x _ _ H Hx Hv Ha) as E. destruct (gain_near _ _ _ _ _ a H Ha) as [_ [d [Hd Eg]]]. facts.
    pose proof (moved_reaches v a t t ltac:(lra) ltac:(lra)).
    assert (moved v a t <= v * t + a * t * t / 2 + / 4 * (u * (A * t * t))); [| lra].
    unfold moved. destruct (Rle_dec 0 (v + a * t)) as [M | M]; [lra |].
    assert (a < 0) as Hneg. { apply Rnot_le_lt. intros N. apply M. assert (0 <= a * t) by (apply Rmult_le_pos; lra). lra. }
    assert (0 <= v + fl (a * dt)) as P. { apply Rnot_lt_le. intros N. apply S. unfold end_speed. apply fl_negative, N. }
    rewrite Eg in P. apply of_abs in Hd.
    destruct (half_square v (- a) ltac:(lra)) as [s [Es Ew]].
    replace (v * v / (-2 * a)) with (v * v / (2 * - a)) by (field; lra). rewrite Ew.
    assert (- a * s * s / 2 - (v * t + a * t * t / 2) = - a * ((t - s) * (t - s)) / 2) as Ed by (rewrite Es; field).
    assert (s <= t). { apply Rnot_lt_le. intros N. apply M. assert (0 < - a * (s - t)) by (apply Rmult_lt_0_compat; lra). lra. }
    assert (t - s <= 2.1 * u * t) as Hts.
    { apply (Rmult_le_reg_l (- a)); [lra |]. assert (- a * t * (- d) <= - a * t * (2.1 * u)); [| lra].
      apply Rmult_le_compat_l; [| lra]. assert (0 <= - a * t) by (apply Rmult_le_pos; lra). lra. }
    assert ((t - s) * (t - s) <= (2.1 * u * t) * (2.1 * u * t)) by (apply Rmult_le_compat; lra).
    assert (- a * ((t - s) * (t - s)) <= A * ((2.1 * u * t) * (2.1 * u * t))) by (apply Rmult_le_compat; nra).
    assert (A * ((2.1 * u * t) * (2.1 * u * t)) = 4.41 * u * (u * (A * t * t))) as E2 by lra.
    assert (4.41 * u * (u * (A * t * t)) <= / 1000 * (u * (A * t * t))) by (apply Rmult_le_compat_r; lra). lra.
Qed.

(** `distance_and_speed_after` in crates/sim/src/control/shield/kernel.rs is `motion::advance` from 0; `ShieldParams::after` computes
    the gap a step later from it. *)
Definition predicted_gap (gap w c v a h : R) : R := fl (fl (gap + advanced 0 w (- c) h) - advanced 0 v a h).

Definition moved_computed (v a dt : R) : R :=
  if Rlt_dec (end_speed v a dt) 0 then fl (fl (v * v) / fl (-2 * a)) else fl (fl (v * dt) + fl (fl (fl (/ 2 * a) * dt) * dt)).

Theorem moved_is_an_advance_from_nothing v a dt : moved_computed v a dt = advanced 0 v a dt.
Proof.
  assert (forall y, fl (fl y) = fl y) as I.
  { intros y. Transparent fl. unfold fl. apply round_generic; [typeclasses eauto |]. apply generic_format_round; typeclasses eauto. }
  unfold moved_computed, advanced. rewrite !Rplus_0_l, !I. reflexivity.
Qed.
Opaque fl.

Lemma advanced_speed_increases v v' a a' dt : 0 <= dt -> v <= v' -> a <= a' -> advanced_speed v a dt <= advanced_speed v' a' dt.
Proof.
  intros Hd Hv Ha. assert (end_speed v a dt <= end_speed v' a' dt).
  { unfold end_speed. apply fl_monotone. assert (fl (a * dt) <= fl (a' * dt)) by (apply fl_monotone, Rmult_le_compat_r; lra). lra. }
  unfold advanced_speed. repeat destruct Rlt_dec; lra.
Qed.

(** Motion in undivided steps. The prediction has at least the own acceleration, or holds it, and a vehicle ahead that brakes fully.
    It is no better than the later motion: to the bit for speeds, up to rounding for the gap. *)
Theorem a_predicted_step_is_no_better X V A h xf x v w v' w' a a' af c len gap e : step_within X V A h h ->
  - X <= xf <= X -> - X <= x <= X -> 0 <= v <= v' -> v' <= V -> 0 <= w' <= w -> w <= V -> 0 < c <= A ->
  - A <= a <= A -> - A <= a' <= A -> a <= a' \/ v = 0 /\ a = 0 -> - c <= af <= A -> - (3 * X) <= gap <= 3 * X ->
  gap <= xf - len - x + e ->
  advanced_speed v a h <= advanced_speed v' a' h /\ advanced_speed w' (- c) h <= advanced_speed w af h /\
  predicted_gap gap w' c v' a' h <= advanced xf w af h - len - advanced x v a h + e + 24 * (u * X).
Proof.
  intros H Hxf Hx Hv HvV Hw HwV Hc Ha Ha' Hless Haf Hg He.
  pose proof (a_position_is_rounded _ _ _ _ _ xf w af H Hxf ltac:(lra) ltac:(lra)) as E1.
  pose proof (a_position_is_rounded _ _ _ _ _ x v a H Hx ltac:(lra) ltac:(lra)) as E2.
  pose proof (a_position_is_rounded _ _ _ _ _ 0 w' (- c) H ltac:(destruct H as [? [? [? [_ ?]]]]; nra) ltac:(lra) ltac:(lra)) as E3.
  pose proof (a_position_is_rounded _ _ _ _ _ 0 v' a' H ltac:(destruct H as [? [? [? [_ ?]]]]; nra) ltac:(lra) ltac:(lra)) as E4.
  facts. pose proof (moved_increases w' w (- c) af h ltac:(lra) ltac:(lra) ltac:(lra)) as M1.
  assert (moved v a h <= moved v' a' h) as M2.
  { destruct Hless as [L | [-> ->]]; [apply moved_increases; lra |].
    pose proof (moved_reaches v' a' 0 h ltac:(lra) ltac:(lra)). unfold moved at 1. destruct Rle_dec; lra. }
  assert (0 <= advanced_speed v' a' h) as N by (unfold advanced_speed; destruct Rlt_dec; lra).
  split; [| split; [apply advanced_speed_increases; lra |]].
  { destruct Hless as [L | [-> ->]]; [apply advanced_speed_increases; lra |].
    assert (advanced_speed 0 0 h = 0) as ->; [| exact N]. unfold advanced_speed, end_speed. rewrite Rmult_0_l, fl_0, Rplus_0_l, fl_0.
    destruct Rlt_dec; reflexivity. }
  assert (forall y i, 0 <= y <= V -> - A <= i <= A -> 0 <= moved y i h <= / 2 * X) as Way.
  { intros y i Hy Hi. split; [pose proof (moved_reaches y i 0 h ltac:(lra) ltac:(lra)); lra |].
    destruct (moved_is y i h) as [s [Hs ->]]; try lra.
    assert (y * s <= V * h) by (apply Rmult_le_compat; lra).
    assert (i * (s * s) <= A * (s * s)) by (apply Rmult_le_compat_r; nra).
    assert (s * s <= h * h) by (apply Rmult_le_compat; lra).
    assert (A * (s * s) <= A * (h * h)) by (apply Rmult_le_compat_l; lra). lra. }
  pose proof (Way w' (- c) ltac:(lra) ltac:(lra)). pose proof (Way v' a' ltac:(lra) ltac:(lra)).
  unfold predicted_gap. set (f := advanced 0 w' (- c) h) in *. set (o := advanced 0 v' a' h) in *.
  assert (Rabs (gap + f) <= 3.6 * X) as B1 by (apply abs_le; lra). pose proof (fl_within _ _ B1).
  assert (Rabs (fl (gap + f) - o) <= 4.2 * X) as B2 by (apply abs_le; lra). pose proof (fl_within _ _ B2). lra.
Qed.

(** Predicted and actual motion over n steps. *)
Theorem predicted_steps_are_no_better X V A h c len (gap v' w' a' xf x v w a af : nat -> R) e n : step_within X V A h h -> 0 < c <= A ->
  (forall i, (i < n)%nat ->
    - X <= xf i <= X /\ - X <= x i <= X /\ - (3 * X) <= gap i <= 3 * X /\ 0 <= v i <= V /\ 0 <= v' i <= V /\ 0 <= w i <= V /\ 0 <= w' i <= V /\
    - A <= a i <= A /\ - A <= a' i <= A /\ (a i <= a' i \/ v i = 0 /\ a i = 0) /\ - c <= af i <= A /\
    gap (S i) = predicted_gap (gap i) (w' i) c (v' i) (a' i) h /\
    v' (S i) = advanced_speed (v' i) (a' i) h /\ w' (S i) = advanced_speed (w' i) (- c) h /\
    xf (S i) = advanced (xf i) (w i) (af i) h /\ x (S i) = advanced (x i) (v i) (a i) h /\
    v (S i) = advanced_speed (v i) (a i) h /\ w (S i) = advanced_speed (w i) (af i) h) ->
  v 0%nat <= v' 0%nat -> w' 0%nat <= w 0%nat -> gap 0%nat <= xf 0%nat - len - x 0%nat + e ->
  v n <= v' n /\ w' n <= w n /\ gap n <= xf n - len - x n + e + INR n * (24 * (u * X)).
Proof.
  intros H Hc. induction n as [| n IH]; intros Hs Hv Hw Hg; [simpl; lra |].
  destruct (IH ltac:(intros i Hi; apply Hs; lia) Hv Hw Hg) as [IHv [IHw IHg]].
  destruct (Hs n ltac:(lia)) as [H1 [H2 [H3 [H4 [H5 [H6 [H7 [H8 [H9 [H10 [H11 [-> [-> [-> [-> [-> [-> ->]]]]]]]]]]]]]]]]].
  destruct (a_predicted_step_is_no_better X V A h (xf n) (x n) (v n) (w n) (v' n) (w' n) (a n) (a' n) (af n) c len (gap n)
    (e + INR n * (24 * (u * X)))) as [R1 [R2 R3]]; try assumption; try lra.
  rewrite S_INR. lra.
Qed.

(** * The margin *)

(** Half a margin covers n steps of full braking and two computations of the spare gap: in the test, and for the check that a state
    is outside the kernel. *)
Theorem half_a_margin_pays p (s : nat -> state) m eta n : bounds_hold p ->
  (forall i, (i < n)%nat -> braking_step p (s i) (s (S i))) ->
  INR n * step_loss p + 2 * eta <= m / 2 -> m - eta <= spare_of p (s 0%nat) ->
  forall i, (i <= n)%nat -> m / 2 + eta <= spare_of p (s i).
Proof.
  intros H Hs Hm H0 i Hi. pose proof (braking_on_takes_at_most p s i H ltac:(intros j Hj; apply Hs; lia)) as B.
  assert (0 <= step_loss p) as Hl.
  { destruct H as [H [Hth [Hsh [_ [_ [HP [_ [Hb [_ HZ]]]]]]]]]. facts. unfold step_loss.
    assert (0 <= stop_time p) by (apply Rmult_le_pos; [lra | left; apply Rinv_0_lt_compat; lra]).
    assert (0 <= lag p) by (unfold lag, Rdiv; apply Rmult_le_pos; [apply Rmult_le_pos; lra | left; apply Rinv_0_lt_compat; lra]).
    assert (0 <= accelerations p * step p) by (apply Rmult_le_pos; lra).
    assert (0 <= stop_time p * (speeds p + 6 * accelerations p * step p)) by (apply Rmult_le_pos; lra).
    assert (0 <= lag p * stop_time p * responses p) by (apply Rmult_le_pos; [apply Rmult_le_pos |]; lra).
    apply Rmult_le_pos; lra. }
  assert (INR i * step_loss p <= INR n * step_loss p) by (apply Rmult_le_compat_r; [lra | apply le_INR; lia]). lra.
Qed.
