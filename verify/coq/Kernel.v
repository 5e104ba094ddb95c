(** The kernel of the shield, for all braking limits, steps and speeds.

    A state is (g, v, w): gap, own speed, speed of the vehicle ahead. The own vehicle can brake at [b];
    the vehicle ahead never brakes harder than [c]. A collision is a gap of zero or less. The Rust functions that the definitions stand for are
    named beside them; docs/kernel-theorems.md has the statements side by side. *)

From Coq Require Import Reals Lra Psatz.
Open Scope R_scope.

(** Distance covered, and speed, [t] after speed [u] while braking at rate [r], at most to standstill:
    `distance_and_speed_after` in crates/sim/src/control/shield/kernel.rs with the acceleration -r. *)
Definition covered (u r t : R) : R :=
  if Rle_dec (r * t) u then u * t - r * t * t / 2 else u * u / (2 * r).
Definition braked (u r t : R) : R :=
  if Rle_dec (r * t) u then u - r * t else 0.

(** The demanded gap: `ViabilityKernel::demanded_gap_m`. *)
Definition D (b c v w : R) : R :=
  if Rle_dec b c then Rmax (v * v / (2 * b) - w * w / (2 * c)) 0
  else if Rle_dec (w * b) (v * c) then Rmax (v * v / (2 * b) - w * w / (2 * c)) 0
  else Rmax (v - w) 0 * Rmax (v - w) 0 / (2 * (b - c)).

(** Decrease of the gap after [t] if both brake fully. *)
Definition closing (b c v w t : R) : R := covered v b t - covered w c t.

(** * Motion *)

Lemma half_square u r : 0 < r -> exists A, u = r * A /\ u * u / (2 * r) = r * A * A / 2.
Proof. intros. exists (u / r). split; field; lra. Qed.

Lemma peak u r s : 0 < r -> u * s - r * s * s / 2 <= u * u / (2 * r).
Proof.
  intros Hr. destruct (half_square u r Hr) as [A [-> ->]].
  assert (0 <= r * ((A - s) * (A - s))) by (apply Rmult_le_pos; [lra | apply Rle_0_sqr]). lra.
Qed.

Lemma covered_at_least u r s t : 0 < r -> 0 <= s <= t -> u * s - r * s * s / 2 <= covered u r t.
Proof.
  intros Hr Hs. unfold covered. destruct (Rle_dec (r * t) u) as [M | M].
  - assert (0 <= r * (t - s)) by (apply Rmult_le_pos; lra).
    assert (0 <= (t - s) * (u - r * (t + s) / 2)) by (apply Rmult_le_pos; lra). lra.
  - apply peak, Hr.
Qed.

Lemma covered_at_most u r t : 0 < r -> covered u r t <= u * u / (2 * r).
Proof.
  intros Hr. unfold covered. destruct (Rle_dec (r * t) u); [apply peak, Hr | lra].
Qed.

Lemma covered_is u r t : 0 < r -> 0 <= u -> 0 <= t ->
  exists s, 0 <= s <= t /\ r * s <= u /\ covered u r t = u * s - r * s * s / 2.
Proof.
  intros Hr Hu Ht. unfold covered. destruct (Rle_dec (r * t) u) as [M | M].
  - exists t. lra.
  - destruct (half_square u r Hr) as [A [-> ->]]. exists A. repeat split; nra.
Qed.

Lemma covered_stopped u r t : 0 < r -> u <= r * t -> covered u r t = u * u / (2 * r).
Proof.
  intros Hr H. unfold covered. destruct (Rle_dec (r * t) u) as [M | M]; [| reflexivity].
  assert (u = r * t) as -> by lra. field. lra.
Qed.

Lemma covered_moving u r t : r * t <= u -> covered u r t = u * t - r * t * t / 2.
Proof. intros H. unfold covered. destruct (Rle_dec (r * t) u); [reflexivity | lra]. Qed.

Lemma covered_nothing u r : 0 <= u -> covered u r 0 = 0.
Proof. intros. rewrite covered_moving; lra. Qed.

Lemma braked_nonneg u r t : 0 <= braked u r t.
Proof. unfold braked. destruct (Rle_dec (r * t) u); lra. Qed.

(** The motion from a later instant is the rest of the same motion. *)
Lemma covered_on u r s t : 0 < r -> 0 <= u -> 0 <= s -> 0 <= t ->
  covered u r (s + t) = covered u r s + covered (braked u r s) r t.
Proof.
  intros Hr Hu Hs Ht. unfold braked. destruct (Rle_dec (r * s) u) as [M | M].
  - rewrite (covered_moving u r s M). unfold covered.
    destruct (Rle_dec (r * (s + t)) u) as [N | N]; destruct (Rle_dec (r * t) (u - r * s)) as [P | P]; try (exfalso; nra).
    + field.
    + field. lra.
  - rewrite (covered_stopped u r s) by lra. rewrite (covered_stopped u r (s + t)) by nra.
    rewrite (covered_stopped 0 r t) by nra. field. lra.
Qed.

Lemma closing_on b c v w s t : 0 < b -> 0 < c -> 0 <= v -> 0 <= w -> 0 <= s -> 0 <= t ->
  closing b c v w (s + t) = closing b c v w s + closing b c (braked v b s) (braked w c s) t.
Proof. intros. unfold closing. rewrite !covered_on by assumption. ring. Qed.

(** A faster vehicle covers more. *)
Lemma covered_increases u u' r t : 0 < r -> 0 <= u <= u' -> 0 <= t -> covered u r t <= covered u' r t.
Proof.
  intros Hr Hu Ht. destruct (covered_is u r t) as [s [Hs [_ ->]]]; try lra.
  apply Rle_trans with (u' * s - r * s * s / 2); [nra | apply covered_at_least; lra].
Qed.

(** * The closed form is the largest closing *)

Theorem demanded_is_enough b c v w t : 0 < b -> 0 < c -> 0 <= v -> 0 <= w -> 0 <= t -> closing b c v w t <= D b c v w.
Proof.
  intros Hb Hc Hv Hw Ht. unfold closing.
  destruct (covered_is v b t) as [s [Hs [Hbs Own]]]; try assumption.
  pose proof (covered_at_least w c s t Hc Hs) as Ahead.
  (* Once the vehicle ahead stands, the difference of the stopping distances bounds the closing. *)
  assert (Stood : w <= c * s -> covered v b t - covered w c t <= v * v / (2 * b) - w * w / (2 * c)).
  { intros H. rewrite (covered_stopped w c t) by nra. pose proof (covered_at_most v b t Hb). lra. }
  destruct (half_square w c Hc) as [B [EB SB]].
  destruct (half_square v b Hb) as [A [EA SA]].
  assert (0 <= A) by nra. assert (0 <= B) by nra.
  unfold D. destruct (Rle_dec b c) as [BC | BC].
  - pose proof (Rmax_l (v * v / (2 * b) - w * w / (2 * c)) 0). pose proof (Rmax_r (v * v / (2 * b) - w * w / (2 * c)) 0).
    destruct (Rle_lt_dec w (c * s)) as [W | W]; [specialize (Stood W); lra |].
    destruct (Rle_lt_dec ((v - w) + (c - b) * s / 2) 0) as [Q | Q].
    + apply Rle_trans with 0; [| lra]. rewrite Own.
      assert (s * ((v - w) + (c - b) * s / 2) <= 0) by nra. nra.
    + destruct (Rle_lt_dec A B) as [AB | AB].
      * exfalso. assert (s <= A) by nra. assert (c * A <= w) by nra. nra.
      * assert (s < B) by nra.
        assert (s * ((v - w) + (c - b) * s / 2) <= B * ((v - w) + (c - b) * B / 2)).
        { apply Rmult_le_compat; nra. }
        rewrite Own. pose proof (peak v b B Hb).
        apply Rle_trans with (v * v / (2 * b) - w * w / (2 * c)); [| lra]. rewrite SB.
        assert (w * B = c * B * B) by (rewrite EB; ring). lra.
  - apply Rnot_le_lt in BC. destruct (Rle_dec (w * b) (v * c)) as [L | L].
    + pose proof (Rmax_l (v * v / (2 * b) - w * w / (2 * c)) 0).
      destruct (Rle_lt_dec w (c * s)) as [W | W]; [specialize (Stood W); lra |].
      assert (s < B) by nra. assert (b * B <= v) by (rewrite EA, EB in L; rewrite EA; nra).
      assert (0 <= (B - s) * ((v - w) - (b - c) * (B + s) / 2)).
      { apply Rmult_le_pos; [lra |]. assert (w = c * B) by assumption. nra. }
      rewrite Own. pose proof (peak v b B Hb).
      apply Rle_trans with (v * v / (2 * b) - w * w / (2 * c)); [| lra]. rewrite SB.
      assert (w * B = c * B * B) by (rewrite EB; ring). lra.
    + assert (0 < b - c) as Hd by lra. rewrite Own.
      apply Rle_trans with ((v - w) * s - (b - c) * s * s / 2); [lra |].
      destruct (Rle_lt_dec v w) as [VW | VW].
      * rewrite Rmax_right by lra. replace (0 * 0 / (2 * (b - c))) with 0 by (field; lra). nra.
      * rewrite Rmax_left by lra. pose proof (peak (v - w) (b - c) s Hd). lra.
Qed.

Theorem demanded_is_needed b c v w : 0 < b -> 0 < c -> 0 <= v -> 0 <= w -> exists t, 0 <= t /\ closing b c v w t = D b c v w.
Proof.
  intros Hb Hc Hv Hw.
  assert (Start : closing b c v w 0 = 0) by (unfold closing; rewrite !covered_nothing by assumption; ring).
  destruct (half_square w c Hc) as [B [EB SB]].
  destruct (half_square v b Hb) as [A [EA SA]].
  assert (0 <= A) by nra. assert (0 <= B) by nra.
  assert (Stops : exists t, 0 <= t /\ closing b c v w t = Rmax (v * v / (2 * b) - w * w / (2 * c)) 0).
  { destruct (Rle_lt_dec (v * v / (2 * b) - w * w / (2 * c)) 0) as [N | P].
    - exists 0. rewrite Rmax_right by assumption. lra.
    - exists (Rmax A B). pose proof (Rmax_l A B). pose proof (Rmax_r A B). split; [lra |].
      rewrite (Rmax_left _ 0) by lra. unfold closing.
      rewrite (covered_stopped v), (covered_stopped w); try assumption; [reflexivity | rewrite EB | rewrite EA];
        apply Rmult_le_compat_l; lra. }
  unfold D. destruct (Rle_dec b c) as [BC | BC]; [exact Stops |].
  destruct (Rle_dec (w * b) (v * c)) as [L | L]; [exact Stops |].
  assert (0 < b - c) as Hd by lra. destruct (Rle_lt_dec v w) as [VW | VW].
  - exists 0. rewrite Rmax_right by lra. split; [lra |]. rewrite Start. field. lra.
  - rewrite Rmax_left by lra. destruct (half_square (v - w) (b - c) Hd) as [E [EE SE]].
    exists E. assert (0 <= E) by nra. split; [assumption |].
    assert (b * E <= v). { assert (c * v < w * b) by nra. assert ((b - c) * (b * E) <= (b - c) * v) by nra. nra. }
    assert (c * E <= w) by nra.
    unfold closing. rewrite !covered_moving by assumption. rewrite SE. nra.
Qed.

(** * Theorems that the shield uses *)

(** Full braking never reduces the spare gap, at any instant, with or without stops: so K = { g > D } is invariant. *)
Theorem full_braking_keeps_the_spare_gap b c g v w s : 0 < b -> 0 < c -> 0 <= v -> 0 <= w -> 0 <= s ->
  g - D b c v w <= (g - closing b c v w s) - D b c (braked v b s) (braked w c s).
Proof.
  intros Hb Hc Hv Hw Hs.
  destruct (demanded_is_needed b c (braked v b s) (braked w c s)) as [t [Ht Et]]; try assumption; try apply braked_nonneg.
  pose proof (demanded_is_enough b c v w (s + t) Hb Hc Hv Hw).
  rewrite (closing_on b c v w s t) in H by assumption. lra.
Qed.

(** Inside the kernel no collision occurs at any instant. *)
Theorem inside_the_kernel_full_braking_is_free_of_contact b c g v w t : 0 < b -> 0 < c -> 0 <= v -> 0 <= w -> 0 <= t ->
  D b c v w < g -> 0 < g - closing b c v w t.
Proof. intros. pose proof (demanded_is_enough b c v w t). lra. Qed.

(** Outside it a collision is unavoidable: against full braking, a vehicle that never brakes harder than [b], and so covers at
    least [covered v b], collides. *)
Theorem outside_the_kernel_nothing_helps b c g v w (own : R -> R) : 0 < b -> 0 < c -> 0 <= v -> 0 <= w ->
  (forall t, 0 <= t -> covered v b t <= own t) -> g <= D b c v w ->
  exists t, 0 <= t /\ g + covered w c t - own t <= 0.
Proof.
  intros Hb Hc Hv Hw Own Out. destruct (demanded_is_needed b c v w) as [t [Ht Et]]; try assumption.
  exists t. split; [assumption |]. specialize (Own t Ht). unfold closing in Et. lra.
Qed.

(** The demand does not rise with the speed of the vehicle ahead, nor fall with the own. *)
Theorem demand_falls_with_the_speed_ahead b c v w w' : 0 < b -> 0 < c -> 0 <= v -> 0 <= w <= w' -> D b c v w' <= D b c v w.
Proof.
  intros Hb Hc Hv Hw. destruct (demanded_is_needed b c v w') as [t [Ht <-]]; try lra.
  apply Rle_trans with (closing b c v w t); [| apply demanded_is_enough; lra].
  unfold closing. pose proof (covered_increases w w' c t). lra.
Qed.

Theorem demand_rises_with_the_own_speed b c v v' w : 0 < b -> 0 < c -> 0 <= v <= v' -> 0 <= w -> D b c v w <= D b c v' w.
Proof.
  intros Hb Hc Hv Hw. destruct (demanded_is_needed b c v w) as [t [Ht <-]]; try lra.
  apply Rle_trans with (closing b c v' w t); [| apply demanded_is_enough; lra].
  unfold closing. pose proof (covered_increases v v' b t). lra.
Qed.

(** * Any vehicle ahead *)

(** Motion that begins at speed [w], never brakes harder than [c] and never reverses: positions [y] whose derivative is the
    speed [f]. *)
Definition within_limit (c w : R) (y f : R -> R) : Prop :=
  y 0 = 0 /\ f 0 = w /\
  (forall t, 0 <= t -> derivable_pt_lim y t (f t)) /\
  (forall t, 0 <= t -> 0 <= f t) /\
  (forall s t, 0 <= s <= t -> f s - c * (t - s) <= f t).

Lemma speed_at_least c w y f t : within_limit c w y f -> 0 <= t -> braked w c t <= f t.
Proof.
  intros [_ [F0 [_ [Pos Lim]]]] Ht. unfold braked. destruct (Rle_dec (c * t) w); [| apply Pos, Ht].
  specialize (Lim 0 t). rewrite F0 in Lim. lra.
Qed.

Lemma covered_step u r s d : 0 < r -> 0 <= u -> 0 <= s -> 0 <= d ->
  covered u r (s + d) - covered u r s <= braked u r (s + d) * d + r * d * d.
Proof.
  intros Hr Hu Hs Hd. rewrite covered_on by assumption.
  destruct (covered_is (braked u r s) r d) as [e [He [Le ->]]]; try assumption; [apply braked_nonneg |].
  revert Le. unfold braked. destruct (Rle_dec (r * s) u) as [M | M]; destruct (Rle_dec (r * (s + d)) u) as [N | N]; intros Le.
  - assert (0 <= (u - r * s) * (d - e)) by (apply Rmult_le_pos; lra). assert (0 <= r * e * e) by (apply Rmult_le_pos; nra). nra.
  - assert (0 <= r * (e * e)) by (apply Rmult_le_pos; nra).
    assert (u - r * s <= r * d) by nra. assert ((u - r * s) * e <= r * d * d) by (apply Rmult_le_compat; nra). nra.
  - exfalso. assert (0 <= r * d) by (apply Rmult_le_pos; lra). lra.
  - assert (e = 0) by nra. subst. assert (0 <= r * (d * d)) by (apply Rmult_le_pos; nra). nra.
Qed.

Lemma braked_falls u r s t : 0 < r -> s <= t -> braked u r t <= braked u r s.
Proof.
  intros Hr H. assert (r * s <= r * t) by (apply Rmult_le_compat_l; lra). unfold braked.
  destruct (Rle_dec (r * s) u); destruct (Rle_dec (r * t) u); lra.
Qed.

Lemma position_nearly_at_least c w y f d n : 0 < c -> 0 <= w -> within_limit c w y f -> 0 < d ->
  covered w c (INR n * d) - INR n * (c * d * d) <= y (INR n * d).
Proof.
  intros Hc Hw Lim Hd. induction n as [| n IH].
  - simpl. rewrite !Rmult_0_l, covered_nothing by assumption. destruct Lim as [-> _]. lra.
  - pose proof (pos_INR n) as Hn. rewrite S_INR. replace ((INR n + 1) * d) with (INR n * d + d) by ring.
    assert (0 <= INR n * d) as Hs by (apply Rmult_le_pos; lra).
    pose proof (covered_step w c (INR n * d) d Hc Hw Hs (Rlt_le _ _ Hd)).
    destruct (MVT_cor2 y f (INR n * d) (INR n * d + d)) as [u [Eq Hu]]; [lra | |].
    { intros x Hx. apply Lim. lra. }
    assert (braked w c (INR n * d + d) <= f u).
    { apply Rle_trans with (braked w c u); [apply braked_falls; lra | apply (speed_at_least c w y f u Lim); lra]. }
    replace (INR n * d + d - INR n * d) with d in Eq by ring.
    assert (braked w c (INR n * d + d) * d <= f u * d) by (apply Rmult_le_compat_r; lra). lra.
Qed.

Theorem whoever_keeps_the_limit_covers_at_least c w y f t : 0 < c -> 0 <= w -> within_limit c w y f -> 0 <= t ->
  covered w c t <= y t.
Proof.
  intros Hc Hw Lim [Ht | <-]; [| rewrite covered_nothing by assumption; destruct Lim as [-> _]; lra].
  apply Rnot_lt_le. intros Less.
  assert (0 < covered w c t - y t) as Gap by lra.
  destruct (archimed_cor1 ((covered w c t - y t) / (c * t * t))) as [n [Small Pos]].
  { apply Rdiv_lt_0_compat; [assumption | repeat apply Rmult_lt_0_compat; assumption]. }
  assert (0 < INR n) as Hn by (apply lt_0_INR; assumption).
  pose proof (position_nearly_at_least c w y f (t / INR n) n Hc Hw Lim) as Near.
  replace (INR n * (t / INR n)) with t in Near by (field; lra).
  replace (INR n * (c * (t / INR n) * (t / INR n))) with (c * t * t * / INR n) in Near by (field; lra).
  assert (0 < t / INR n) by (apply Rdiv_lt_0_compat; assumption). specialize (Near H).
  assert (0 < c * t * t) as P by (repeat apply Rmult_lt_0_compat; assumption).
  apply (Rmult_lt_compat_l (c * t * t)) in Small; [| assumption].
  replace (c * t * t * ((covered w c t - y t) / (c * t * t))) with (covered w c t - y t) in Small by (field; lra).
  lra.
Qed.

(** Suppose a step leaves the state in the kernel by [m] and the gap open by [m] while the vehicle ahead brakes fully. Then it does so
    for any motion of that vehicle within its limit, and any own motion. `ShieldParams::admits` tests the former. *)
Theorem the_worst_leader_stands_for_all b c g w h m v' (own y f : R -> R) : 0 < b -> 0 < c -> 0 <= w -> 0 <= v' -> 0 <= h ->
  within_limit c w y f ->
  (forall t, 0 <= t <= h -> m <= g + covered w c t - own t) ->
  D b c v' (braked w c h) + m <= g + covered w c h - own h ->
  (forall t, 0 <= t <= h -> m <= g + y t - own t) /\ D b c v' (f h) + m <= g + y h - own h.
Proof.
  intros Hb Hc Hw Hv Hh Lim Inside End. split.
  - intros t Ht. specialize (Inside t Ht). pose proof (whoever_keeps_the_limit_covers_at_least c w y f t Hc Hw Lim). lra.
  - pose proof (whoever_keeps_the_limit_covers_at_least c w y f h Hc Hw Lim Hh).
    pose proof (speed_at_least c w y f h Lim Hh). pose proof (braked_nonneg w c h).
    pose proof (demand_falls_with_the_speed_ahead b c v' (braked w c h) (f h)). lra.
Qed.

(** From inside the kernel, full braking avoids a collision at every instant, and the spare gap never falls, for any motion of the
    vehicle ahead within its limit. *)
Theorem full_braking_is_safe_behind_anyone b c g v w s (y f : R -> R) : 0 < b -> 0 < c -> 0 <= v -> 0 <= w -> 0 <= s ->
  within_limit c w y f ->
  g - D b c v w <= g + y s - covered v b s /\
  g - D b c v w <= (g + y s - covered v b s) - D b c (braked v b s) (f s).
Proof.
  intros Hb Hc Hv Hw Hs Lim.
  pose proof (demanded_is_enough b c v w s Hb Hc Hv Hw Hs) as Enough.
  pose proof (full_braking_keeps_the_spare_gap b c g v w s Hb Hc Hv Hw Hs) as Keeps.
  pose proof (whoever_keeps_the_limit_covers_at_least c w y f s Hc Hw Lim Hs).
  pose proof (speed_at_least c w y f s Lim Hs). pose proof (braked_nonneg w c s). pose proof (braked_nonneg v b s).
  pose proof (demand_falls_with_the_speed_ahead b c (braked v b s) (braked w c s) (f s)).
  unfold closing in *. split; lra.
Qed.

(** * An actuator with lag *)

(** Distance covered [t] after speed [u] at a held acceleration [a], at most to standstill: `distance_and_speed_after`. *)
Definition moved (u a t : R) : R :=
  if Rle_dec 0 (u + a * t) then u * t + a * t * t / 2 else u * u / (-2 * a).
Definition moved_speed (u a t : R) : R := if Rle_dec 0 (u + a * t) then u + a * t else 0.

(** In each step of length [h] the response covers [share] of its difference to the command, here full braking:
    `ShieldParams::response_mps2`. *)
Definition response (b share r : R) : R := r + share * (- b - r).

(** Substitute for the own speed in the kernel: `ShieldParams::speed_to_lose_mps`, with `ShieldParams::lag_s`. *)
Definition to_lose (b h share v r : R) : R := v + h * (1 - share) / share * (r + b).

(** The vehicle is at no instant farther than one that brakes at once from [to_lose]. If it still moves at the end of the step, its
    [to_lose] is less by exactly b h. *)
Theorem full_braking_through_lag b h share v r t : 0 < b -> 0 < h -> 0 < share <= 1 -> 0 <= v -> - b <= r -> 0 <= t <= h ->
  moved v (response b share r) t <= covered (to_lose b h share v r) b t /\
  to_lose b h share (v + response b share r * h) (response b share r) = to_lose b h share v r - b * h.
Proof.
  intros Hb Hh Hs Hv Hr Ht.
  set (lag := h * (1 - share) / share). assert (0 <= lag) as Hl.
  { unfold lag, Rdiv. apply Rmult_le_pos; [apply Rmult_le_pos; lra | left; apply Rinv_0_lt_compat; lra]. }
  assert (share * lag = h * (1 - share)) as El by (unfold lag; field; lra).
  set (k := (1 - share) * (r + b)).
  assert (0 <= k) as Hk by (apply Rmult_le_pos; lra).
  assert (response b share r = k - b) as Er by (unfold response, k; ring).
  assert (h * k <= lag * (r + b)) as Hz.
  { assert (h * k = share * (lag * (r + b))) as -> by (unfold k; rewrite <- (Rmult_assoc share lag), El; ring).
    assert (0 <= lag * (r + b)) by (apply Rmult_le_pos; lra). nra. }
  split.
  - unfold to_lose. fold lag. rewrite Er. set (z := v + lag * (r + b)).
    assert (v + k * t <= z). { assert (k * t <= k * h) by (apply Rmult_le_compat_l; lra). unfold z. lra. }
    assert (0 <= z). { assert (0 <= k * t) by (apply Rmult_le_pos; lra). lra. }
    unfold moved. destruct (Rle_dec 0 (v + (k - b) * t)) as [M | M].
    + rewrite covered_moving by lra. assert (0 <= t * (z - (v + k * t))) by (apply Rmult_le_pos; lra).
      assert (0 <= k * t * t) by (repeat apply Rmult_le_pos; lra). lra.
    + assert (0 < b - k) as Hd. { apply Rnot_le_lt. intros N. apply M. assert (0 <= (k - b) * t) by (apply Rmult_le_pos; lra). lra. }
      destruct (half_square v (b - k) Hd) as [A [EA SA]].
      replace (v * v / (-2 * (k - b))) with (v * v / (2 * (b - k))) by (field; lra). rewrite SA.
      assert (0 <= A <= t). { split; apply Rnot_lt_le; intros N; [nra |]. apply M. rewrite EA.
        assert (0 <= (b - k) * (A - t)) by (apply Rmult_le_pos; lra). lra. }
      apply Rle_trans with (z * A - b * A * A / 2); [| apply covered_at_least; lra].
      assert (v + k * A <= z). { assert (k * A <= k * t) by (apply Rmult_le_compat_l; lra). lra. }
      assert (0 <= A * (z - (v + k * A))) by (apply Rmult_le_pos; lra).
      assert (0 <= k * A * A) by (repeat apply Rmult_le_pos; lra).
      assert (v * A = (b - k) * A * A) by (rewrite EA at 1; ring). lra.
  - unfold to_lose, response. field. lra.
Qed.
