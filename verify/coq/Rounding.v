(** What rounding in double precision takes of the gap, in steps of full braking and in the shield's test.

    The Rust functions that the definitions stand for are named beside them, docs/kernel-theorems.md has the statements side by side. *)

From Coq Require Import Reals Lra Psatz.
From Flocq Require Import Core Relative.
Require Import Kernel.
Open Scope R_scope.

(** * One operation *)

(** The nearest number of 53 binary digits, ties to even: what an operation of f64 gives where it does not underflow or overflow. *)
Definition fl (x : R) : R := round radix2 (FLX_exp 53) ZnearestE x.

(** Half the distance of 1 from the next number: `U`. *)
Definition u : R := / 2 * bpow radix2 (- 53 + 1).

#[global] Instance fifty_three : Prec_gt_0 53.
Proof. reflexivity. Qed.

Theorem numbers_of_f64_are_these x : bpow radix2 (-1022) <= Rabs x -> round radix2 (FLT_exp (-1074) 53) ZnearestE x = fl x.
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

(** `motion::advance` in crates/world/src/sim/motion.rs, operation by operation: position and speed. *)
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

(** Without a stop: the speed, and the way. *)
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

(** The vehicle ahead covers at least what it would braking fully, and is at least as fast after that, up to rounding. *)
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

(** What takes the place of the own speed, `Frame::speed_to_lose_mps`: of an actuator that responds with r until the step's end and then
    approaches -B, rho is what is left of the step and of the lag. *)
Definition left_to_lose (B rho v r : R) : R :=
  if Rle_dec v 0 then if Rle_dec r 0 then 0 else v + rho * Rmax (r + B) 0 else v + rho * Rmax (r + B) 0.

(** The own acceleration: what the actuator responds, with noise up to n, and a rounded sum; who stands is held. *)
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

(** The way to a stop that comes before t, or hardly later. *)
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
  (* with a stop: the way *)
  all: try (assert (v * v / (-2 * a) <= covered (left_to_lose B rho v r) b t + 2 * (u * (A * t * t))) as C; [| lra];
    apply (stopped_way A v a t (fun s => covered (left_to_lose B rho v r) b s)); try lra;
    [ intros s Hs'; apply W; lra | intros s Hs'; apply covered_rises; lra ]).
  (* with a stop: the speed *)
  all: try (unfold left_to_lose at 1; destruct (Rle_dec 0 0); [| lra]; destruct (Rle_dec r 0); [lra |];
    assert (Rmax (r + B) 0 = r + B) as Er by (apply Rmax_left; lra); rewrite Er in *;
    assert (0 <= (B - n + u * A - b) * t) by (apply Rmult_le_pos; lra); assert (0 <= r * t) by (apply Rmult_le_pos; lra);
    assert (0 <= n * t) by (apply Rmult_le_pos; lra);
    rewrite Ez; unfold braked; destruct Rle_dec; lra).
  (* without: the way *)
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
(** * What the demand makes of errors of speeds *)

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

(** * What a step of full braking takes of the spare gap *)

(** Of the numbers that the simulation holds: len is the length of the vehicle ahead. *)
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

(** `Frame::response_mps2`, operation by operation; `Actuator::respond` does the same, or without lag and delay gives what is due, exactly. *)
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

(** At the end of a step tau = h (1 - share) / share is left to lose, `Frame::lag_s`; the next response is held over h. *)
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
