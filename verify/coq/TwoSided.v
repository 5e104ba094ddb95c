(** The two-sided shield, for all limits, steps, states and plans: no collision with the leader or with the follower.

    The ego vehicle acts at samples, [h] apart. The leader never brakes harder than [c]. The follower belongs to a class.
    docs/two-sided.md has
    the statements side by side. *)

From Coq Require Import Reals Lra Psatz.
Require Import Kernel.
Open Scope R_scope.

(** * Motion within a step *)

(** Positions [z] from 0 with speed [q], for a time [h], without reversing. *)
Definition motion (h : R) (z q : R -> R) : Prop :=
  z 0 = 0 /\ (forall t, 0 <= t <= h -> derivable_pt_lim z t (q t)) /\ (forall t, 0 <= t <= h -> 0 <= q t).

(** From [t1] to [t2] the acceleration is at most [a]; at least -[e]; at most -[r] until standstill. *)
Definition gains_at_most (a : R) (q : R -> R) (t1 t2 : R) : Prop := forall s t, t1 <= s <= t -> t <= t2 -> q t <= q s + a * (t - s).
Definition loses_at_most (e : R) (q : R -> R) (t1 t2 : R) : Prop := forall s t, t1 <= s <= t -> t <= t2 -> q s - e * (t - s) <= q t.
Definition brakes_at_least (r : R) (q : R -> R) (t1 t2 : R) : Prop := forall s t, t1 <= s <= t -> t <= t2 ->
  q t <= Rmax 0 (q s - r * (t - s)).

(** Farthest position, and highest speed, after [t] of a vehicle that gains [a] until [d] and then brakes at [r]. *)
Definition reached (u a d r t : R) : R :=
  let s := Rmin t d in u * s + a * s * s / 2 + covered (u + a * s) r (t - s).
Definition speed_reached (u a d r t : R) : R :=
  let s := Rmin t d in braked (u + a * s) r (t - s).

Lemma squared_nonneg r d : 0 <= r -> 0 <= r * d * d.
Proof. intros. rewrite Rmult_assoc. apply Rmult_le_pos; [lra | apply Rle_0_sqr]. Qed.

Lemma covered_nearly u r t d : 0 <= r -> 0 <= u ->
  - (r * d * d) <= covered u r (t + d) - covered u r t - braked u r t * d <= r * d * d.
Proof.
  intros Hr Hu. pose proof (squared_nonneg r d Hr) as Hd. unfold covered, braked.
  destruct (Req_dec r 0) as [-> | N].
  - destruct (Rle_dec (0 * (t + d)) u); destruct (Rle_dec (0 * t) u); try lra; exfalso; lra.
  - assert (0 < r) by lra. destruct (half_square u r H) as [A [EA SA]]. rewrite SA.
    destruct (Rle_dec (r * (t + d)) u) as [P | P]; destruct (Rle_dec (r * t) u) as [Q | Q].
    + lra.
    + assert (A < t) by nra. assert (t + d <= A) by nra.
      assert (0 <= r * (A - (t + d)) * (A - (t + d))) by (apply squared_nonneg; lra).
      assert (r * (A - (t + d)) * (A - (t + d)) <= r * d * d) by nra. subst u. split; nra.
    + assert (t <= A) by nra. assert (A < t + d) by nra.
      assert (0 <= r * (A - t) * (A - t)) by (apply squared_nonneg; lra). subst u.
      assert (r * (A - t) * (A - t) <= r * d * d) by nra. assert (r * (A - t) * d <= r * d * d) by nra. split; nra.
    + lra.
Qed.

Lemma covered_derivable u r t : 0 <= r -> 0 <= u -> derivable_pt_lim (covered u r) t (braked u r t).
Proof.
  intros Hr Hu eps He. assert (0 < eps / (r + 1)) as Hd by (apply Rdiv_lt_0_compat; lra).
  exists (mkposreal _ Hd). intros d Nz Small. simpl in Small.
  pose proof (covered_nearly u r t d Hr Hu) as [L U].
  set (D := covered u r (t + d) - covered u r t) in *.
  replace (D / d - braked u r t) with ((D - braked u r t * d) / d) by (field; exact Nz).
  unfold Rdiv. rewrite Rabs_mult, Rabs_inv.
  assert (0 < Rabs d) by (apply Rabs_pos_lt; exact Nz).
  assert (Rabs (D - braked u r t * d) <= r * (Rabs d * Rabs d)) as B.
  { apply Rabs_le. replace (Rabs d * Rabs d) with (d * d) by (rewrite <- Rabs_mult; symmetry; apply Rabs_pos_eq; nra). split; lra. }
  apply (Rmult_lt_reg_r (Rabs d)); [assumption |]. rewrite Rmult_assoc, Rinv_l, Rmult_1_r by lra.
  apply Rle_lt_trans with (r * (Rabs d * Rabs d)); [exact B |].
  apply (Rmult_lt_compat_r (r + 1)) in Small; [| lra]. unfold Rdiv in Small. rewrite Rmult_assoc, Rinv_l, Rmult_1_r in Small by lra.
  rewrite <- Rmult_assoc. apply Rmult_lt_compat_r; [assumption |]. nra.
Qed.

Lemma slower_is_behind z q Z Q t : 0 <= t ->
  (forall s, 0 <= s <= t -> derivable_pt_lim z s (q s)) -> (forall s, 0 <= s <= t -> derivable_pt_lim Z s (Q s)) ->
  (forall s, 0 <= s <= t -> q s <= Q s) -> z t - z 0 <= Z t - Z 0.
Proof.
  intros [Ht | <-] Dz DZ Le; [| lra].
  destruct (MVT_cor2 (fun s => Z s - z s) (fun s => Q s - q s) 0 t Ht) as [s [E Hs]].
  { intros s Hs. apply (derivable_pt_lim_minus Z z s (Q s) (q s)); auto. }
  assert (0 <= (Q s - q s) * (t - 0)) by (apply Rmult_le_pos; [specialize (Le s); lra | lra]). lra.
Qed.

Lemma quadratic_derivable p k t : derivable_pt_lim (fun s => p * s + k * s * s / 2) t (p + k * t).
Proof.
  assert (derivable_pt_lim (fun s => p * s + k / 2 * (s * s)) t (p * 1 + k / 2 * (1 * t + t * 1))) as H.
  { apply (derivable_pt_lim_plus (fun s => p * s) (fun s => k / 2 * (s * s))).
    - apply (derivable_pt_lim_scal (fun s => s)), derivable_pt_lim_id.
    - apply (derivable_pt_lim_scal (fun s => s * s)), (derivable_pt_lim_mult (fun s => s) (fun s => s)); apply derivable_pt_lim_id. }
  intros eps He. destruct (H eps He) as [d Hd]. exists d. intros k' N S. specialize (Hd k' N S).
  replace (p + k * t) with (p * 1 + k / 2 * (1 * t + t * 1)) by field.
  replace (p * (t + k') + k * (t + k') * (t + k') / 2) with (p * (t + k') + k / 2 * ((t + k') * (t + k'))) by field.
  replace (p * t + k * t * t / 2) with (p * t + k / 2 * (t * t)) by field. exact Hd.
Qed.

Lemma gains_covers_at_most h a z q t : motion h z q -> gains_at_most a q 0 h -> 0 <= t <= h -> z t <= q 0 * t + a * t * t / 2.
Proof.
  intros [Z0 [Dz _]] G Ht.
  pose proof (slower_is_behind z q (fun s => q 0 * s + a * s * s / 2) (fun s => q 0 + a * s) t) as H. simpl in H.
  assert (z t - z 0 <= q 0 * t + a * t * t / 2 - (q 0 * 0 + a * 0 * 0 / 2)); [| rewrite Z0 in *; lra].
  apply H; [lra | intros; apply Dz; lra | intros; apply quadratic_derivable |].
  intros s Hs. specialize (G 0 s). replace (s - 0) with s in G by ring. apply G; lra.
Qed.

(** A vehicle at the speed [q t] has not accelerated all the time. For each [s], this bounds its position; the smallest bound is that of
    the fastest one less a deficit. *)
Theorem farthest_at_a_speed h a e z q t s : motion h z q -> gains_at_most a q 0 h -> loses_at_most e q 0 h -> 0 <= s <= t -> t <= h ->
  z t <= q 0 * s + a * s * s / 2 + q t * (t - s) + e * (t - s) * (t - s) / 2.
Proof.
  intros M G L Hs Ht. pose proof M as [Z0 [Dz Pos]].
  assert (z s <= q 0 * s + a * s * s / 2) as Z1 by (apply gains_covers_at_most with (h := h); try assumption; lra).
  assert (z (s + (t - s)) - z (s + 0) <= ((q t + e * (t - s)) * (t - s) + - e * (t - s) * (t - s) / 2) -
    ((q t + e * (t - s)) * 0 + - e * 0 * 0 / 2)) as Z2.
  { apply (slower_is_behind (fun x => z (s + x)) (fun x => q (s + x)) (fun x => (q t + e * (t - s)) * x + - e * x * x / 2)
      (fun x => q t + e * (t - s) + - e * x) (t - s)).
    - lra.
    - intros x Hx eps He. destruct (Dz (s + x)) with (eps := eps) as [k Hk]; [lra | assumption |]. exists k. intros y Ny Sy.
      specialize (Hk y Ny Sy). replace (s + (x + y)) with (s + x + y) by ring. exact Hk.
    - intros x Hx. apply quadratic_derivable.
    - intros x Hx. assert (q (s + x) - e * (t - (s + x)) <= q t) by (apply L; lra). lra. }
  replace (s + (t - s)) with t in Z2 by ring. rewrite Rplus_0_r in Z2. lra.
Qed.

(** The fastest one, less the deficit. *)
Theorem the_deficit_of_a_speed h a z q t u : motion h z q -> 0 < a -> gains_at_most a q 0 h -> loses_at_most a q 0 h -> 0 <= t <= h ->
  q 0 <= u -> u - a * t <= q t -> let lost := u + a * t - q t in z t <= u * t + a * t * t / 2 - lost * lost / (4 * a).
Proof.
  intros M Ha G L Ht Hu Hq lost. assert (q t <= q 0 + a * (t - 0)) as Gt by (apply G; lra).
  set (s := t - lost / (2 * a)). assert (lost / (2 * a) * (2 * a) = lost) as E by (field; lra).
  assert (0 <= lost / (2 * a) <= t) as Hl.
  { split; apply (Rmult_le_reg_r (2 * a)); try lra; rewrite E; unfold lost; nra. }
  assert (0 <= s <= t) as Hs by (unfold s; lra).
  pose proof (farthest_at_a_speed h a a z q t s M G L Hs (proj2 Ht)) as F.
  assert (q 0 * s <= u * s) by (apply Rmult_le_compat_r; lra).
  assert (u * s + a * s * s / 2 + q t * (t - s) + a * (t - s) * (t - s) / 2 = u * t + a * t * t / 2 - lost * lost / (4 * a)) as Eq.
  { assert (q t = u + a * t - lost) as -> by (unfold lost; ring). unfold s. field. lra. }
  lra.
Qed.

Lemma loses_covers_at_least h e z q t : motion h z q -> loses_at_most e q 0 h -> 0 <= e -> 0 <= t <= h ->
  covered (q 0) e t <= z t /\ braked (q 0) e t <= q t.
Proof.
  intros [Z0 [Dz Pos]] G He Ht.
  assert (forall s, 0 <= s <= t -> braked (q 0) e s <= q s) as B.
  { intros s Hs. unfold braked. destruct (Rle_dec (e * s) (q 0)); [| apply Pos; lra].
    specialize (G 0 s). replace (s - 0) with s in G by ring. apply G; lra. }
  split; [| apply B; lra]. assert (0 <= q 0) as Q0 by (apply Pos; lra).
  assert (covered (q 0) e t - covered (q 0) e 0 <= z t - z 0).
  { apply slower_is_behind with (q := braked (q 0) e) (Q := q); try lra; [intros; apply covered_derivable; lra | intros; apply Dz;
      lra | assumption]. }
  rewrite (covered_nothing (q 0) e Q0), Z0 in *. lra.
Qed.

(** The squared speed grows by at most twice the acceleration times the distance. *)
Lemma speed_grows_with_distance h a z q : motion h z q -> gains_at_most a q 0 h -> 0 <= a -> 0 <= h -> q h * q h <= q 0 * q 0 + 2 * a * z h.
Proof.
  intros [Z0 [Dz Pos]] G Ha Hh. assert (0 <= q h) as Qh by (apply Pos; lra). assert (0 <= q 0) as Q0 by (apply Pos; lra).
  assert (forall s, 0 <= s <= h -> q h - a * (h - s) <= q s) as B by (intros s Hs; specialize (G s h);
    assert (q h <= q s + a * (h - s)) by (apply G; lra); lra).
  assert (q h - a * h <= q 0) as B0 by (specialize (B 0); rewrite Rminus_0_r in B; apply B; lra).
  assert (forall k, 0 <= k <= h -> q h * k - a * k * k / 2 <= z h) as C.
  { intros k Hk.
    assert (z (h - k) - z 0 >= 0) as Back.
    { pose proof (slower_is_behind (fun _ => 0) (fun _ => 0) z q (h - k)) as N. simpl in N. apply Rle_ge.
      apply Rle_trans with (0 - 0); [lra |]. apply N; try lra; intros; [apply derivable_pt_lim_const | apply Dz; lra | apply Pos; lra]. }
    assert ((q h - a * k) * k + a * k * k / 2 - ((q h - a * k) * 0 + a * 0 * 0 / 2) <= z (h - k + k) - z (h - k + 0)) as F.
    { apply (slower_is_behind (fun s => (q h - a * k) * s + a * s * s / 2) (fun s => q h - a * k + a * s) (fun s => z (h - k + s)) (fun s
        => q (h - k + s)) k).
      - lra.
      - intros s Hs. apply quadratic_derivable.
      - intros s Hs eps He. destruct (Dz (h - k + s)) with (eps := eps) as [d Hd]; [lra | assumption |]. exists d. intros y Ny Sy.
        specialize (Hd y Ny Sy). replace (h - k + (s + y)) with (h - k + s + y) by ring. exact Hd.
      - intros s Hs. specialize (B (h - k + s)). replace (h - (h - k + s)) with (k - s) in B by ring.
        assert (q h - a * (k - s) <= q (h - k + s)) by (apply B; lra). lra. }
    replace (h - k + k) with h in F by ring. rewrite Z0 in Back. rewrite Rplus_0_r in F. lra. }
  destruct (Rle_lt_dec (a * h) (q h)) as [E | E].
  - specialize (C h (conj Hh (Rle_refl h))). assert ((q h - a * h) * (q h - a * h) <= q 0 * q 0) by (apply Rmult_le_compat; lra).
    assert (2 * a * (q h * h - a * h * h / 2) <= 2 * a * z h) by (apply Rmult_le_compat_l; lra). lra.
  - assert (0 < a) as Pa by (destruct Ha as [Ha | <-]; lra). assert (0 <= q h / a <= h) as Hk.
    { split; [apply Rmult_le_pos; [exact Qh | left; apply Rinv_0_lt_compat; exact Pa] |]. apply (Rmult_le_reg_l a); [exact Pa |].
      replace (a * (q h / a)) with (q h) by (field; lra). lra. }
    specialize (C (q h / a) Hk). assert (q h * (q h / a) - a * (q h / a) * (q h / a) / 2 = q h * q h / (2 * a)) as Eq by (field; lra).
    rewrite Eq in C. assert (2 * a * (q h * q h / (2 * a)) <= 2 * a * z h) as M by (apply Rmult_le_compat_l; lra).
    replace (2 * a * (q h * q h / (2 * a))) with (q h * q h) in M by (field; lra). pose proof (Rle_0_sqr (q 0)) as Sq. unfold Rsqr in Sq.
    lra.
Qed.

Lemma braked_is u r t : braked u r t = Rmax 0 (u - r * t).
Proof. unfold braked, Rmax. destruct (Rle_dec (r * t) u); destruct (Rle_dec 0 (u - r * t)); lra. Qed.

(** A vehicle that brakes from [d] on stays within [reached]. *)
Theorem the_follower_is_bounded h a d r z q t : motion h z q -> 0 <= a -> 0 < r -> 0 <= d ->
  gains_at_most a q 0 (Rmin h d) -> brakes_at_least r q d h -> 0 <= t <= h ->
  z t <= reached (q 0) a d r t /\ q t <= speed_reached (q 0) a d r t.
Proof.
  intros M Ha Hr Hd G B Ht. pose proof M as [Z0 [Dz Pos]]. unfold reached, speed_reached.
  assert (0 <= q 0) as Q0 by (apply Pos; lra).
  set (s := Rmin t d). assert (0 <= s <= t /\ s <= d) as Hs by (unfold s, Rmin; destruct (Rle_dec t d); lra).
  assert (s <= Rmin h d) as Hm by (unfold s, Rmin; destruct (Rle_dec t d); destruct (Rle_dec h d); lra).
  assert (q s <= q 0 + a * s) as Qs. { specialize (G 0 s). replace (s - 0) with s in G by ring. apply G; lra. }
  assert (z s <= q 0 * s + a * s * s / 2) as Zs.
  { apply gains_covers_at_most with (h := s); [| | lra].
    - split; [assumption |]. split; intros; [apply Dz | apply Pos]; lra.
    - intros x y Hx Hy. apply G; lra. }
  assert (0 <= a * s) by (apply Rmult_le_pos; lra). assert (0 <= q s) as Qp by (apply Pos; lra).
  destruct (Rle_lt_dec t d) as [E | E].
  - assert (s = t) as -> by (unfold s; apply Rmin_left; exact E).
    replace (t - t) with 0 by ring. rewrite covered_nothing by lra. rewrite braked_is.
    pose proof (Rmax_r 0 (q 0 + a * t - r * 0)). lra.
  - assert (s = d) as Es by (unfold s; apply Rmin_right; lra). rewrite Es in *.
    assert (forall x, 0 <= x <= t - d -> q (d + x) <= braked (q d) r x) as Q.
    { intros x Hx. rewrite braked_is. specialize (B d (d + x)). replace (d + x - d) with x in B by ring. apply B; lra. }
    assert (z t - z d <= covered (q d) r (t - d)) as Zt.
    { assert (z (d + (t - d)) - z (d + 0) <= covered (q d) r (t - d) - covered (q d) r 0) as H0.
      { apply (slower_is_behind (fun x => z (d + x)) (fun x => q (d + x)) (covered (q d) r) (braked (q d) r) (t - d)).
        - lra.
        - intros x Hx eps He. destruct (Dz (d + x)) with (eps := eps) as [k Hk]; [lra | assumption |]. exists k. intros y Ny Sy.
          specialize (Hk y Ny Sy). replace (d + (x + y)) with (d + x + y) by ring. exact Hk.
        - intros. apply covered_derivable; lra.
        - exact Q. }
      rewrite covered_nothing in H0 by assumption. replace (d + (t - d)) with t in H0 by ring. rewrite Rplus_0_r in H0. lra. }
    split.
    + pose proof (covered_increases (q d) (q 0 + a * d) r (t - d)). lra.
    + specialize (Q (t - d)). replace (d + (t - d)) with t in Q by ring.
      apply Rle_trans with (braked (q d) r (t - d)); [apply Q; lra |]. rewrite !braked_is. apply Rle_max_compat_l. lra.
Qed.

Lemma braked_on u r s t : 0 <= r -> 0 <= s -> 0 <= t -> braked (braked u r s) r t = braked u r (s + t).
Proof.
  intros. rewrite !braked_is. assert (0 <= r * t) by (apply Rmult_le_pos; lra). assert (0 <= r * s) by (apply Rmult_le_pos; lra).
  unfold Rmax. repeat destruct Rle_dec; lra.
Qed.

(** The bound from a later instant is the rest of the same bound. *)
Lemma reached_on u a d r s t : 0 < r -> 0 <= u -> 0 <= a -> 0 <= d -> 0 <= s -> 0 <= t ->
  reached u a d r (s + t) = reached u a d r s + reached (speed_reached u a d r s) a (Rmax 0 (d - s)) r t.
Proof.
  intros Hr Hu Ha Hd Hs Ht. unfold reached, speed_reached. destruct (Rle_lt_dec s d) as [E | E].
  - rewrite (Rmin_left s d), (Rmax_right 0 (d - s)) by lra. replace (s - s) with 0 by ring.
    assert (0 <= a * s) by (apply Rmult_le_pos; lra).
    rewrite covered_nothing by lra. rewrite (braked_is (u + a * s)), Rmult_0_r, Rmax_right by lra.
    replace (Rmin (s + t) d) with (s + Rmin t (d - s)) by (unfold Rmin; repeat destruct Rle_dec; lra).
    set (x := Rmin t (d - s)). replace (u + a * s - 0 + a * x) with (u + a * (s + x)) by ring.
    replace (s + t - (s + x)) with (t - x) by ring. field.
  - rewrite (Rmin_right s d), (Rmax_left 0 (d - s)), (Rmin_right t 0), (Rmin_right (s + t) d) by lra.
    assert (0 <= a * d) by (apply Rmult_le_pos; lra). replace (s + t - d) with ((s - d) + t) by ring.
    rewrite covered_on by lra. replace (braked (u + a * d) r (s - d) + a * 0) with (braked (u + a * d) r (s - d)) by ring.
    replace (t - 0) with t by ring. field.
Qed.

Lemma reached_increases u u' a d r t : 0 < r -> 0 <= u <= u' -> 0 <= a -> 0 <= d -> 0 <= t -> reached u a d r t <= reached u' a d r t.
Proof.
  intros Hr Hu Ha Hd Ht. unfold reached. set (s := Rmin t d).
  assert (0 <= s <= t) by (unfold s, Rmin; destruct (Rle_dec t d); lra). assert (0 <= a * s) by (apply Rmult_le_pos; lra).
  pose proof (covered_increases (u + a * s) (u' + a * s) r (t - s)). assert (u * s <= u' * s) by (apply Rmult_le_compat_r; lra). lra.
Qed.

(** Braking later reaches farther. *)
Lemma reached_later u a d d' r t : 0 < r -> 0 <= u -> 0 <= a -> 0 <= d <= d' -> 0 <= t -> reached u a d r t <= reached u a d' r t.
Proof.
  intros Hr Hu Ha Hd Ht. destruct (Rle_lt_dec t d) as [E | E].
  - unfold reached. rewrite !Rmin_left by lra. lra.
  - unfold reached at 1. rewrite Rmin_right by lra. unfold reached. set (s := Rmin t d').
    assert (d <= s <= t) as Hs by (unfold s, Rmin; destruct (Rle_dec t d'); lra).
    assert (0 <= a * d) by (apply Rmult_le_pos; lra).
    assert (a * d <= a * s) by (apply Rmult_le_compat_l; lra).
    destruct (covered_is (u + a * d) r (t - d)) as [x [Hx [Bx ->]]]; try lra.
    destruct (Rle_lt_dec x (s - d)) as [F | F].
    + assert (0 <= covered (u + a * s) r (t - s)).
      { pose proof (covered_at_least (u + a * s) r 0 (t - s) Hr). lra. }
      assert (0 <= r * x * x) by (apply squared_nonneg; lra).
      assert ((u + a * d) * x <= (u + a * d) * (s - d)) by (apply Rmult_le_compat_l; lra).
      assert (0 <= a * (s - d) * (s - d)) by (apply squared_nonneg; lra).
      replace (u * s + a * s * s / 2) with (u * d + a * d * d / 2 + (u + a * d) * (s - d) + a * (s - d) * (s - d) / 2) by field. lra.
    + pose proof (covered_at_least (u + a * s) r (x - (s - d)) (t - s) Hr).
      assert (0 <= a * (s - d) * (s - d)) by (apply squared_nonneg; lra).
      assert (0 <= (s - d) * (x - (s - d))) by (apply Rmult_le_pos; lra).
      assert (0 <= a * ((s - d) * (x - (s - d)))) by (apply Rmult_le_pos; lra).
      assert (0 <= r * (s - d) * (s - d)) by (apply squared_nonneg; lra).
      assert (0 <= r * ((s - d) * (x - (s - d)))) by (apply Rmult_le_pos; lra).
      replace (u * s + a * s * s / 2) with (u * d + a * d * d / 2 + (u + a * d) * (s - d) + a * (s - d) * (s - d) / 2) by field.
      nra.
Qed.
(** * The world *)

(** An ego vehicle: in a step that begins in state [i], it holds the acceleration [held i a] after command [a] and ends in state [next i a].
    Delay and lag belong to the state. [visible] tells whether a follower sees it brake in this step. *)
Record vehicle := Vehicle { inner : Type; speed : inner -> R; held : inner -> R -> R; next : inner -> R -> inner; visible : inner -> R ->
  bool }.

(** A follower reacts to the visible braking of the ego vehicle, or fires at the first sample at which the time to collision is less than
    [ttc]. From then on it brakes at [bf] or more at the latest after [rho]; if it reacts, as long as the ego vehicle brakes. *)
Inductive kind := Reacts | Fires.
Inductive phase := Waiting | Braking (remaining : R).

(** Acceleration of a follower: in [-fall, rise] before it fires or sees braking ([fall] matters only if it fires); then at most [react].
    A follower that has not fired and is slower than [creep] behind a standing ego vehicle is not covered. *)
Record world := World { dt : R; limit : R; margin_ahead : R; margin_behind : R;
  class : kind; ttc : R; rho : R; bf : R; fall : R; rise : R; react : R; creep : R }.

Definition valid (W : world) : Prop :=
  0 < dt W /\ 0 < limit W /\ dt W <= ttc W /\ 0 <= rho W /\ 0 < bf W /\ 0 <= fall W /\ 0 <= rise W /\ 0 <= react W.

(** Gap ahead, speed of the leader, gap behind and speed of the follower, at a sample. *)
Record state (V : vehicle) := State { ego : inner V; ahead : R; lead : R; behind : R; rear : R; stage : phase }.
Arguments State {V}. Arguments ego {V}. Arguments ahead {V}. Arguments lead {V}. Arguments behind {V}. Arguments rear {V}.
Arguments stage {V}.

Definition fired {V} (W : world) (s : state V) : bool :=
  match stage s with
  | Braking _ => true
  | Waiting => if Rlt_dec (behind s) (ttc W * (rear s - speed V (ego s))) then true else false
  end.
Definition alarmed {V} (W : world) (s : state V) (a : R) : bool :=
  match class W with Reacts => visible V (ego s) a | Fires => fired W s end.
Definition due {V} (W : world) (s : state V) : R := match stage s with Waiting => rho W | Braking remaining => remaining end.

Definition own {V} (s : state V) (a t : R) : R := moved (speed V (ego s)) (held V (ego s) a) t.

(** Motion of the follower in a step, and its phase at the end. *)
Definition follower {V} (W : world) (s : state V) (a : R) (z q : R -> R) (after : phase) : Prop :=
  motion (dt W) z q /\ q 0 = rear s /\
  if alarmed W s a
  then gains_at_most (react W) q 0 (Rmin (dt W) (due W s)) /\ brakes_at_least (bf W) q (due W s) (dt W) /\
    after = Braking (Rmax 0 (due W s - dt W))
  else gains_at_most (rise W) q 0 (dt W) /\ after = Waiting /\
    (class W = Fires -> loses_at_most (fall W) q 0 (dt W) /\ (0 < speed V (ego s) \/ creep W <= rear s)).

(** A step with command [a], the motion [y], [f] of the leader and the motion [z], [q] of the follower. *)
Definition step {V} (W : world) (s : state V) (a : R) (y f z q : R -> R) (s' : state V) : Prop :=
  within_limit (limit W) (lead s) y f /\ follower W s a z q (stage s') /\
  s' = State (next V (ego s) a) (ahead s + y (dt W) - own s a (dt W)) (f (dt W)) (behind s + own s a (dt W) - z (dt W)) (q (dt W)) (stage
    s').

Definition apart {V} (W : world) (s : state V) (a : R) (y z : R -> R) : Prop := forall t, 0 <= t <= dt W ->
  margin_ahead W <= ahead s + y t - own s a t /\ margin_behind W <= behind s + own s a t - z t.

(** * Plans *)

(** Commands until the follower has fired; then, if that was after n steps, the commands [after n]. *)
Inductive plan := Wait (first : nat -> R) (after : nat -> nat -> R) | Go (commands : nat -> R).

Definition later {A : Type} (p : nat -> A) : nat -> A := fun n => p (S n).
Definition resolve {V} (W : world) (s : state V) (p : plan) : plan :=
  match p with Wait _ after => if fired W s then Go (after O) else p | Go _ => p end.
Definition command (p : plan) : R := match p with Wait first _ => first O | Go commands => commands O end.
Definition tail (p : plan) : plan := match p with Wait first after => Wait (later first) (later after) | Go commands => Go (later
  commands) end.

(** What may happen while the ego vehicle executes a plan. *)
Inductive leads {V} (W : world) : state V -> plan -> state V -> plan -> Prop :=
| nowhere s p : leads W s p s p
| onward s p s1 p1 y f z q s2 : leads W s p s1 p1 -> step W s1 (command (resolve W s1 p1)) y f z q s2 ->
  leads W s p s2 (tail (resolve W s1 p1)).

(** The plan avoids collisions on both sides, whatever the leader and the follower do. *)
Definition covers {V} (W : world) (s : state V) (p : plan) : Prop := forall s1 p1, leads W s p s1 p1 ->
  forall y f z q s2, step W s1 (command (resolve W s1 p1)) y f z q s2 -> apart W s1 (command (resolve W s1 p1)) y z.

Definition in_S {V} (W : world) (s : state V) : Prop := exists p, covers W s p.

Lemma leads_first {V} W (s s1 : state V) p y f z q : step W s (command (resolve W s p)) y f z q s1 ->
  forall s2 p2, leads W s1 (tail (resolve W s p)) s2 p2 -> leads W s p s2 p2.
Proof.
  intros First s2 p2 H. remember (tail (resolve W s p)) as p1 eqn:E. revert First E.
  induction H as [s1 p1 | s1 p1 s2 p2 y' f' z' q' s3 H IH Next]; intros First ->.
  - exact (onward W s p s p y f z q s1 (nowhere W s p) First).
  - exact (onward W s p s2 p2 y' f' z' q' s3 (IH First eq_refl) Next).
Qed.

(** The tail of a plan is a plan. *)
Theorem the_tail_of_a_plan_is_a_plan V W (s s' : state V) p y f z q : covers W s p -> step W s (command (resolve W s p)) y f z q s' ->
  covers W s' (tail (resolve W s p)).
Proof. intros C First s1 p1 H. apply C. exact (leads_first W s s' p y f z q First s1 p1 H). Qed.

(** The filter executes the first command of a plan that covers the state. Behind every leader within its limit and before every follower of
    the class, both gaps stay open, and the state stays in S. *)
Theorem two_sided V W (s s' : state V) p y f z q : covers W s p -> step W s (command (resolve W s p)) y f z q s' ->
  apart W s (command (resolve W s p)) y z /\ in_S W s'.
Proof.
  intros C First. split; [exact (C s p (nowhere W s p) y f z q s' First) |].
  exists (tail (resolve W s p)). exact (the_tail_of_a_plan_is_a_plan V W s s' p y f z q C First).
Qed.

(** In a run, the plan in use at each sample covers the state, as the test shows, or it is the rest of the plan before. *)
Theorem the_filter_never_collides V W (s : nat -> state V) (p : nat -> plan) (y f z q : nat -> R -> R) :
  (forall n, covers W (s n) (p n) \/ exists k, n = S k /\ p n = tail (resolve W (s k) (p k))) ->
  (forall n, step W (s n) (command (resolve W (s n) (p n))) (y n) (f n) (z n) (q n) (s (S n))) ->
  forall n, apart W (s n) (command (resolve W (s n) (p n))) (y n) (z n) /\ in_S W (s n).
Proof.
  intros Plan Step n. assert (covers W (s n) (p n)) as C.
  { induction n as [| n IH]; destruct (Plan O) as [C0 | [k [E _]]]; try discriminate E; try exact C0.
    destruct (Plan (S n)) as [C | [k [E ->]]]; [exact C |]. injection E as <-.
    exact (the_tail_of_a_plan_is_a_plan V W _ _ _ _ _ _ _ IH (Step n)). }
  split; [| exists (p n); exact C]. exact (proj1 (two_sided V W _ _ _ _ _ _ _ C (Step n))).
Qed.

(** What each step keeps up covers. *)
Lemma invariant_covers V W (I : state V -> plan -> Prop) :
  (forall s p y f z q s', I s p -> step W s (command (resolve W s p)) y f z q s' ->
    apart W s (command (resolve W s p)) y z /\ I s' (tail (resolve W s p))) ->
  forall s p, I s p -> covers W s p.
Proof.
  intros Keeps s p Begin s1 p1 H. assert (I s1 p1) as H1.
  { induction H as [| s p s1 p1 y f z q s2 H IH Next]; [exact Begin |]. exact (proj2 (Keeps s1 p1 y f z q s2 (IH Begin) Next)). }
  intros y f z q s2 Next. exact (proj1 (Keeps s1 p1 y f z q s2 H1 Next)).
Qed.

(** * The motion of the ego vehicle along commands *)

Fixpoint at_step (V : vehicle) (i : inner V) (p : nat -> R) (n : nat) : inner V :=
  match n with O => i | S n => at_step V (next V i (p O)) (later p) n end.
Definition travels (V : vehicle) (i : inner V) (a t : R) : R := moved (speed V i) (held V i a) t.
Fixpoint place (V : vehicle) (i : inner V) (p : nat -> R) (h : R) (n : nat) : R :=
  match n with O => 0 | S n => travels V i (p O) h + place V (next V i (p O)) (later p) h n end.

(** Position [t] after the [n]th sample. *)
Definition drives (V : vehicle) (i : inner V) (p : nat -> R) (h : R) (n : nat) (t : R) : R :=
  place V i p h n + travels V (at_step V i p n) (p n) t.

Lemma at_step_last V n : forall i p, at_step V i p (S n) = next V (at_step V i p n) (p n).
Proof. induction n as [| n IH]; intros i p; [reflexivity |]. exact (IH (next V i (p O)) (later p)). Qed.

Lemma place_first V i p h n : place V i p h (S n) = travels V i (p O) h + place V (next V i (p O)) (later p) h n.
Proof. reflexivity. Qed.

Lemma place_last V h n : forall i p, place V i p h (S n) = place V i p h n + travels V (at_step V i p n) (p n) h.
Proof.
  induction n as [| n IH]; intros i p; [rewrite place_first; unfold place, at_step; ring |].
  rewrite place_first, IH, (place_first V i p h n). change (at_step V i p (S n)) with (at_step V (next V i (p O)) (later p) n).
  change (later p n) with (p (S n)). ring.
Qed.

Lemma drives_later V i p h n t : drives V i p h (S n) t = travels V i (p O) h + drives V (next V i (p O)) (later p) h n t.
Proof. unfold drives. rewrite place_first. change (later p n) with (p (S n)). cbn [at_step]. ring. Qed.
(** * Plans after the follower has begun to brake *)

(** The worst leader stays ahead (A), and the worst follower stays behind (B), from a state of the ego vehicle on. *)
Definition stays_behind_the_leader {V} (W : world) (i : inner V) (g w : R) (p : nat -> R) : Prop := forall n t, 0 <= t <= dt W ->
  margin_ahead W <= g + covered w (limit W) (INR n * dt W + t) - drives V i p (dt W) n t.
Definition stays_ahead_of_the_follower {V} (W : world) (i : inner V) (r u d : R) (p : nat -> R) : Prop := forall n t, 0 <= t <= dt W ->
  margin_behind W <= r + drives V i p (dt W) n t - reached u (react W) d (bf W) (INR n * dt W + t).

Lemma steps_nonneg h n t : 0 < h -> 0 <= t -> 0 <= INR n * h + t.
Proof. intros. pose proof (pos_INR n). assert (0 <= INR n * h) by (apply Rmult_le_pos; lra). lra. Qed.

Lemma the_leader_in_a_step c w y f h t : 0 < c -> 0 <= h -> 0 <= t -> within_limit c w y f ->
  covered w c (h + t) <= y h + covered (f h) c t.
Proof.
  intros Hc Hh Ht L. assert (0 <= w) as Hw by (destruct L as [_ [<- [_ [P _]]]]; apply P; lra).
  pose proof (whoever_keeps_the_limit_covers_at_least c w y f h Hc Hw L Hh). pose proof (speed_at_least c w y f h L Hh).
  pose proof (braked_nonneg w c h). pose proof (covered_increases (braked w c h) (f h) c t Hc). rewrite covered_on by assumption. lra.
Qed.

(** Bounds of estimates suffice: a gap or a speed ahead that is too small; behind, a gap that is too small, a speed or a remaining time
    that is too large. *)
Theorem bounds_ahead_suffice V W (i : inner V) g g' w w' p : valid W -> g <= g' -> 0 <= w <= w' ->
  stays_behind_the_leader W i g w p -> stays_behind_the_leader W i g' w' p.
Proof.
  intros [Hh [Hc _]] Hg Hw A n t Ht. specialize (A n t Ht).
  pose proof (covered_increases w w' (limit W) (INR n * dt W + t) Hc Hw (steps_nonneg _ n t Hh (proj1 Ht))). lra.
Qed.

Theorem bounds_behind_suffice V W (i : inner V) r r' u u' d d' p : valid W -> r <= r' -> 0 <= u' <= u -> 0 <= d' <= d ->
  stays_ahead_of_the_follower W i r u d p -> stays_ahead_of_the_follower W i r' u' d' p.
Proof.
  intros [Hh [Hc [_ [_ [Hb [_ [_ Ha]]]]]]] Hr Hu Hd B n t Ht. specialize (B n t Ht). pose proof (steps_nonneg _ n t Hh (proj1 Ht)) as Hn.
  pose proof (reached_increases u' u (react W) d (bf W) (INR n * dt W + t) Hb Hu Ha).
  pose proof (reached_later u' (react W) d' d (bf W) (INR n * dt W + t) Hb).
  lra.
Qed.

Lemma fired_is {V} W (s : state V) : fired W s = true <-> stage s <> Waiting \/ behind s < ttc W * (rear s - speed V (ego s)).
Proof.
  unfold fired. destruct (stage s); [| split; [left; discriminate | reflexivity]].
  destruct (Rlt_dec _ _); split; intros H; try reflexivity; try discriminate; [right; assumption |].
  destruct H; [congruence | contradiction].
Qed.

(** The follower of a state in which it brakes, or begins to. *)
Definition executes {V} (W : world) (s : state V) (p : plan) : Prop := exists commands,
  resolve W s p = Go commands /\ 0 <= due W s /\
  match class W with Fires => fired W s = true | Reacts => forall n, visible V (at_step V (ego s) commands n) (commands n) = true end /\
  stays_behind_the_leader W (ego s) (ahead s) (lead s) commands /\
  stays_ahead_of_the_follower W (ego s) (behind s) (rear s) (due W s) commands.

Lemma A_in_a_step V W (s s' : state V) p y f z q : valid W -> step W s (p O) y f z q s' ->
  stays_behind_the_leader W (ego s) (ahead s) (lead s) p ->
  (forall t, 0 <= t <= dt W -> margin_ahead W <= ahead s + y t - own s (p O) t) /\
  stays_behind_the_leader W (ego s') (ahead s') (lead s') (later p).
Proof.
  intros [Hh [Hc _]] [L [_ E]] A. split.
  - intros t Ht. specialize (A O t Ht). unfold drives in A. simpl in A. replace (0 * dt W + t) with t in A by ring.
    assert (0 <= lead s) as Hw by (destruct L as [_ [<- [_ [P _]]]]; apply P; lra).
    pose proof (whoever_keeps_the_limit_covers_at_least _ _ y f t Hc Hw L (proj1 Ht)). unfold travels in A. unfold own. lra.
  - intros n t Ht. specialize (A (S n) t Ht). rewrite drives_later, S_INR in A. rewrite E. simpl.
    pose proof (the_leader_in_a_step _ _ y f (dt W) (INR n * dt W + t) Hc (Rlt_le _ _ Hh) (steps_nonneg _ n t Hh (proj1 Ht)) L).
    replace ((INR n + 1) * dt W + t) with (dt W + (INR n * dt W + t)) in A by ring. unfold own. unfold travels in A at 1. lra.
Qed.

Lemma executes_on V W (s s' : state V) p y f z q : valid W -> executes W s p -> step W s (command (resolve W s p)) y f z q s' ->
  apart W s (command (resolve W s p)) y z /\ executes W s' (tail (resolve W s p)).
Proof.
  intros Val [p1 [E [Hd [Al [A B]]]]] St. rewrite E in *. simpl in *.
  destruct (A_in_a_step V W s s' p1 y f z q Val St A) as [A0 A1].
  destruct Val as [Hh [Hc [_ [_ [Hb [_ [_ Ha]]]]]]]. destruct St as [L [[M [Q0 F]] E']].
  assert (alarmed W s (p1 O) = true) as Al0 by (unfold alarmed; destruct (class W); [exact (Al O) | exact Al]).
  rewrite Al0 in F. destruct F as [Ga [Br Ph]].
  assert (forall t, 0 <= t <= dt W -> z t <= reached (rear s) (react W) (due W s) (bf W) t /\
    q t <= speed_reached (rear s) (react W) (due W s) (bf W) t) as Z.
  { intros t Ht. rewrite <- Q0. apply the_follower_is_bounded with (h := dt W); assumption. }
  assert (forall t, 0 <= t <= dt W -> 0 <= q t) as Qp by apply M. assert (0 <= rear s) by (rewrite <- Q0; apply Qp; lra).
  split.
  - intros t Ht. split; [exact (A0 t Ht) |]. specialize (B O t Ht). unfold drives in B. simpl in B.
    replace (0 * dt W + t) with t in B by ring.
    destruct (Z t Ht). unfold travels in B. unfold own. lra.
  - exists (later p1). assert (due W s' = Rmax 0 (due W s - dt W)) as D by (unfold due at 1; rewrite Ph; reflexivity).
    split; [reflexivity |]. split; [rewrite D; apply Rmax_l |]. split; [| split; [exact A1 |]].
    + destruct (class W); [| apply fired_is; left; rewrite Ph; discriminate]. intros n. specialize (Al (S n)). rewrite E'. exact Al.
    + intros n t Ht. rewrite D. specialize (B (S n) t Ht). rewrite drives_later, S_INR in B. rewrite E'. simpl.
      replace ((INR n + 1) * dt W + t) with (dt W + (INR n * dt W + t)) in B by ring.
      pose proof (steps_nonneg _ n t Hh (proj1 Ht)) as Hn. rewrite reached_on in B by lra. destruct (Z (dt W)) as [Z1 Q1]; [lra |].
      pose proof (reached_increases (q (dt W)) _ (react W) (Rmax 0 (due W s - dt W)) (bf W) (INR n * dt W + t) Hb
        (conj (Qp (dt W) ltac:(lra)) Q1) Ha (Rmax_l _ _) Hn).
      unfold own. unfold travels in B at 1. lra.
Qed.

(** A and B suffice once the follower brakes or begins to brake. *)
Theorem both_conditions_suffice V W (s : state V) p : valid W -> executes W s p -> covers W s p.
Proof. intros Val. apply invariant_covers. intros s0 p0 y f z q s' I St. exact (executes_on V W s0 s' p0 y f z q Val I St). Qed.

(** The tail of such a plan passes A and B again: its level does not fall. *)
Theorem the_tail_passes_both_conditions V W (s s' : state V) p y f z q : valid W -> executes W s p ->
  step W s (command (resolve W s p)) y f z q s' -> executes W s' (tail (resolve W s p)).
Proof. intros Val I St. exact (proj2 (executes_on V W s s' p y f z q Val I St)). Qed.
(** * Plans before the follower has fired *)

(** The speed of the ego vehicle follows from what it holds. *)
Definition sound (V : vehicle) (h : R) : Prop := forall i a, 0 <= speed V i ->
  speed V (next V i a) = moved_speed (speed V i) (held V i a) h.

(** Bounds of an observation: least gap and speed ahead; least and largest gap behind, and speed of the follower. *)
Record bounds := Bounds { gap : R; leader : R; gap_min : R; gap_max : R; rear_min : R; rear_max : R }.

Definition within {V} (s : state V) (b : bounds) : Prop := gap b <= ahead s /\ 0 <= leader b <= lead s /\
  gap_min b <= behind s <= gap_max b /\ 0 <= rear_min b <= rear s /\ rear s <= rear_max b.

(** Speeds of a follower that has not fired in n steps, and gaps to it. *)
Definition slowest (W : world) (b : bounds) (n : nat) : R := braked (rear_min b) (fall W) (INR n * dt W).
Definition fastest (W : world) (b : bounds) (n : nat) : R := rear_max b + rise W * (INR n * dt W).
Definition nearest {V} (W : world) (i : inner V) (b : bounds) (p : nat -> R) (n : nat) : R :=
  gap_min b + place V i p (dt W) n - (rear_max b * (INR n * dt W) + rise W * (INR n * dt W) * (INR n * dt W) / 2).
Definition remotest {V} (W : world) (i : inner V) (b : bounds) (p : nat -> R) (n : nat) : R :=
  gap_max b + place V i p (dt W) n - covered (rear_min b) (fall W) (INR n * dt W).

(** Excess of the condition of firing at the first sample at which it holds: [closing] is the closing speed there, [a] what the ego vehicle
    held in the step before. *)
Definition overshoot (W : world) (a closing : R) : R := (closing + (ttc W - dt W / 2) * (rise W + Rmax 0 (- a))) * dt W.

Lemma motion_of_the_ego v a h : 0 <= v -> 0 <= h ->
  v * h - Rmax 0 (- a) * h * h / 2 <= moved v a h /\ v <= moved_speed v a h + Rmax 0 (- a) * h /\ 0 <= moved_speed v a h.
Proof.
  intros Hv Hh. pose proof (Rmax_l 0 (- a)). pose proof (Rmax_r 0 (- a)). set (d := Rmax 0 (- a)) in *.
  assert (- a * h <= d * h) by (apply Rmult_le_compat_r; lra). assert (- a * h * h <= d * h * h) by (apply Rmult_le_compat_r; lra).
  unfold moved, moved_speed. destruct (Rle_dec 0 (v + a * h)) as [M | M]; [lra |].
  assert (a < 0). { apply Rnot_le_lt. intros N. apply M. assert (0 <= a * h) by (apply Rmult_le_pos; lra). lra. }
  pose proof (peak v (- a) h). replace (2 * - a) with (-2 * a) in H4 by ring. lra.
Qed.

(** Least gap at the [n]th sample to a follower with speed [u] that has not fired before. *)
Definition line {V} (W : world) (i : inner V) (b : bounds) (p : nat -> R) (n : nat) (u : R) : R :=
  match n with
  | O => gap_min b
  | S k => (ttc W - dt W) * (u - rise W * dt W) - ttc W * speed V (at_step V i p k)
      + travels V (at_step V i p k) (p k) (dt W) - rise W * dt W * dt W / 2
  end.

(** At the first sample at which the condition of firing holds, the gap is at least that of the condition, less the overshoot. *)
Theorem the_overshoot_of_a_sample V W (i : inner V) b p k u : valid W -> sound V (dt W) -> 0 <= speed V (at_step V i p k) ->
  let closing := u - speed V (at_step V i p (S k)) in
  ttc W * closing - overshoot W (held V (at_step V i p k) (p k)) closing <= line W i b p (S k) u.
Proof.
  intros [Hh [_ [HT [_ [_ [_ [Hi _]]]]]]] So Hv. unfold line, overshoot, travels. rewrite at_step_last, So by exact Hv.
  set (v := speed V (at_step V i p k)) in *. set (a := held V (at_step V i p k) (p k)).
  destruct (motion_of_the_ego v a (dt W)) as [X [S _]]; try lra. set (d := Rmax 0 (- a)) in *. set (v' := moved_speed v a (dt W)) in *.
  assert (0 <= (ttc W - dt W) * (v' + d * dt W - v)) by (apply Rmult_le_pos; lra). cbv zeta. lra.
Qed.

(** A speed and a gap of a follower that has not fired before the [n]th sample.
The squared speed has grown by at most twice [rise] times the
    distance covered. *)
Definition possible {V} (W : world) (i : inner V) (b : bounds) (p : nat -> R) (n : nat) (r u : R) : Prop :=
  slowest W b n <= u <= fastest W b n /\ nearest W i b p n <= r <= remotest W i b p n /\ line W i b p n u <= r /\
  u * u <= rear_max b * rear_max b + 2 * rise W * (gap_max b + place V i p (dt W) n - r) /\
  match n with O => True | S k => 0 < speed V (at_step V i p k) \/ creep W - fall W * dt W <= u end.

(** A follower that fires at the [n]th sample: A and B hold. *)
Definition safe_if_it_fires {V} (W : world) (i : inner V) (b : bounds) (p q : nat -> R) (n : nat) (r u : R) : Prop :=
  (forall k t, 0 <= t <= dt W -> margin_ahead W <=
    gap b + covered (leader b) (limit W) (INR n * dt W + (INR k * dt W + t)) - place V i p (dt W) n - drives V (at_step V i p n) q (dt W)
      k t) /\
  stays_ahead_of_the_follower W (at_step V i p n) r u (rho W) q.

(** A follower that does not: both gaps stay open in the step that begins there. *)
Definition safe_if_it_waits {V} (W : world) (i : inner V) (b : bounds) (p : nat -> R) (n : nat) (r u : R) : Prop := forall t,
  0 <= t <= dt W ->
  margin_ahead W <= gap b + covered (leader b) (limit W) (INR n * dt W + t) - drives V i p (dt W) n t /\
  margin_behind W <= r + travels V (at_step V i p n) (p n) t - (u * t + rise W * t * t / 2).

(** A plan while the follower waits. At the sample [last], if there is one, every follower has fired. *)
Definition passes_while_waiting {V} (W : world) (i : inner V) (b : bounds) (p : nat -> R) (after : nat -> nat ->
  R) (last : option nat) : Prop :=
  forall n, match last with Some k => (n <= k)%nat | None => True end -> forall r u, possible W i b p n r u ->
    (r < ttc W * (u - speed V (at_step V i p n)) -> safe_if_it_fires W i b p (after n) n r u) /\
    (ttc W * (u - speed V (at_step V i p n)) <= r -> 0 < speed V (at_step V i p n) \/ creep W <= u ->
      last <> Some n /\ safe_if_it_waits W i b p n r u).

Lemma covered_slower_on u e s t : 0 <= e -> 0 <= u -> 0 <= s -> 0 <= t -> covered u e (s + t) = covered u e s + covered (braked u e s) e t.
Proof.
  intros He Hu Hs Ht. destruct He as [He | <-]; [apply covered_on; assumption |].
  unfold covered, braked. destruct (Rle_dec (0 * (s + t)) u); destruct (Rle_dec (0 * s) u); try (exfalso; lra).
  destruct (Rle_dec (0 * t) (u - 0 * s)); [field | exfalso; lra].
Qed.

Lemma covered_slower_increases u u' e t : 0 <= e -> 0 <= u <= u' -> 0 <= t -> covered u e t <= covered u' e t.
Proof.
  intros [He | <-] Hu Ht; [apply covered_increases; assumption |].
  assert (u * t <= u' * t) by (apply Rmult_le_compat_r; lra).
  unfold covered. destruct (Rle_dec (0 * t) u); destruct (Rle_dec (0 * t) u'); lra.
Qed.

(** The state after n steps in which the follower has not fired. *)
Definition waits {V} (W : world) (i : inner V) (b : bounds) (p : nat -> R) (after : nat -> nat -> R) (last : option nat) (n : nat)
    (s : state V) (rest : plan) : Prop :=
  (exists p' after', rest = Wait p' after' /\ (forall j, p' j = p (n + j)%nat) /\ (forall j, after' j = after (n + j)%nat)) /\
  stage s = Waiting /\ ego s = at_step V i p n /\ match last with Some k => (n <= k)%nat | None => True end /\
  possible W i b p n (behind s) (rear s) /\ 0 <= speed V (ego s) /\
  (forall t, 0 <= t -> gap b + covered (leader b) (limit W) (INR n * dt W + t) - place V i p (dt W) n <= ahead s + covered (lead s) (limit
    W) t).

Lemma waits_and_fires V W (i : inner V) b p after last n (s : state V) rest : valid W -> class W = Fires ->
  passes_while_waiting W i b p after last -> waits W i b p after last n s rest -> fired W s = true -> executes W s rest.
Proof.
  intros [Hh [_ [_ [Hr _]]]] Cl P [[p' [af [-> [_ Af]]]] [St [Eg [Na [Po [_ Le]]]]]] Fi.
  assert (due W s = rho W) as Du by (unfold due; rewrite St; reflexivity).
  destruct (P n Na (behind s) (rear s) Po) as [Safe _]. rewrite <- Eg in Safe.
  destruct Safe as [A B]; [apply fired_is in Fi; destruct Fi; [congruence | assumption] |].
  exists (after n). split; [simpl; rewrite Fi, Af; f_equal; f_equal; apply Nat.add_0_r |]. rewrite Cl, Du. split; [exact Hr |].
  split; [exact Fi |]. rewrite Eg in *. split; [| exact B]. intros k t Ht. specialize (A k t Ht).
  specialize (Le _ (steps_nonneg _ k t Hh (proj1 Ht))). lra.
Qed.

Lemma waits_on V W (i : inner V) b p after last n (s s' : state V) rest y f z q : valid W -> class W = Fires -> sound V (dt W) ->
  0 <= rear_min b ->
  passes_while_waiting W i b p after last -> waits W i b p after last n s rest -> fired W s = false ->
  step W s (command (resolve W s rest)) y f z q s' ->
  apart W s (command (resolve W s rest)) y z /\ waits W i b p after last (S n) s' (tail (resolve W s rest)).
Proof.
  intros [Hh [Hc [HT [_ [_ [Hf [Hi _]]]]]]] Cl So Ru P [[p' [af [-> [Fp Af]]]] [St [Eg [Na [Po [Sp Le]]]]]] Fi Step.
  simpl in *. rewrite Fi in *. simpl in *. assert (p' O = p n) as P0 by (rewrite Fp; f_equal; apply Nat.add_0_r). rewrite P0 in *.
  destruct Step as [L [[M [Q0 F]] E']]. unfold alarmed in F. rewrite Cl, Fi in F. destruct F as [Ga [Ph Lo]].
  destruct (Lo eq_refl) as [Lo' Creep]. clear Lo. rename Lo' into Lo.
  assert (0 <= lead s) as Hw by (destruct L as [_ [<- [_ [Pos _]]]]; apply Pos; lra).
  assert (ttc W * (rear s - speed V (ego s)) <= behind s) as Un.
  { apply Rnot_lt_le. intros N. assert (fired W s = true) by (apply fired_is; right; exact N). congruence. }
  assert (Un' := Un). rewrite Eg in Un'. destruct (P n Na (behind s) (rear s) Po) as [_ Safe].
  destruct (Safe Un') as [NotLast Open]; [rewrite <- Eg; exact Creep |]. clear Safe.
  assert (forall t, 0 <= t <= dt W -> z t <= rear s * t + rise W * t * t / 2) as Zu.
  { intros t Ht. rewrite <- Q0. apply gains_covers_at_most with (h := dt W) (q := q); assumption. }
  destruct (loses_covers_at_least (dt W) (fall W) z q (dt W) M Lo Hf) as [Zl Ql]; [lra |]. rewrite Q0 in *.
  assert (q (dt W) <= rear s + rise W * dt W) as Qu.
  { specialize (Ga 0 (dt W)). rewrite Q0 in Ga. replace (dt W - 0) with (dt W) in Ga by ring. apply Ga; lra. }
  set (tau := INR n * dt W) in *. assert (0 <= tau) as Ht0 by (apply Rmult_le_pos; [apply pos_INR | lra]).
  assert (INR (S n) * dt W = tau + dt W) as Tau by (rewrite S_INR; unfold tau; ring).
  assert (own s (p n) (dt W) = travels V (at_step V i p n) (p n) (dt W)) as Own by (unfold own, travels; rewrite Eg; reflexivity).
  destruct Po as [[Us Uf] [[Rn Rr] [_ [En _]]]]. unfold slowest, fastest, nearest, remotest in Us, Uf, Rn, Rr. fold tau in Us, Uf, Rn, Rr.
  pose proof (braked_nonneg (rear_min b) (fall W) tau) as B0.
  split; [| split; [| split; [| split; [| split; [| split; [| split]]]]]].
  - intros t Ht. destruct (Open t Ht) as [A B]. unfold own. rewrite Eg. fold (travels V (at_step V i p n) (p n) t). split.
    + unfold drives in A. specialize (Le t (proj1 Ht)).
      pose proof (whoever_keeps_the_limit_covers_at_least _ _ y f t Hc Hw L (proj1 Ht)). fold tau in A. lra.
    + specialize (Zu t Ht). lra.
  - exists (later p'), (later af). split; [reflexivity |]. split; intros j; unfold later; rewrite ?Fp, ?Af; f_equal; apply Nat.add_succ_r.
  - exact Ph.
  - rewrite E'. cbn [ego ahead lead behind rear stage]. rewrite Eg. symmetry. apply (at_step_last V n i p).
  - destruct last as [k |]; [| exact I]. apply le_lt_eq_dec in Na. destruct Na as [Na | ->]; [exact Na | congruence].
  - rewrite E'. cbn [ego ahead lead behind rear stage]. unfold possible, slowest, fastest, nearest, remotest.
    rewrite Tau, (place_last V (dt W) n i p), <- Own.
    split; [| split; [| split; [| split]]].
    + rewrite <- braked_on by lra. split; [| lra]. eapply Rle_trans; [| exact Ql]. rewrite !braked_is. apply Rle_max_compat_l.
      rewrite braked_is in Us. lra.
    + split.
      * specialize (Zu (dt W)). assert (rear s * dt W <= (rear_max b + rise W * tau) * dt W) by (apply Rmult_le_compat_r; lra). lra.
      * rewrite covered_slower_on by lra. pose proof (covered_slower_increases (braked (rear_min b) (fall W) tau) (rear s) (fall W) (dt
          W)). lra.
    + unfold line. rewrite <- Own, <- Eg. specialize (Zu (dt W)).
      assert ((ttc W - dt W) * (q (dt W) - rise W * dt W) <= (ttc W - dt W) * rear s) by (apply Rmult_le_compat_l; lra). lra.
    + assert (q (dt W) * q (dt W) <= rear s * rear s + 2 * rise W * z (dt W)).
      { rewrite <- Q0. apply (speed_grows_with_distance (dt W) (rise W) z q M Ga Hi (Rlt_le _ _ Hh)). }
      lra.
    + rewrite <- Eg. destruct Creep as [Moves | Creep]; [left; exact Moves | right]. rewrite braked_is in Ql.
      pose proof (Rmax_r 0 (rear s - fall W * dt W)). lra.
  - rewrite E'. cbn [ego ahead lead behind rear stage]. rewrite So by exact Sp. apply motion_of_the_ego; lra.
  - intros t Ht. rewrite E'. cbn [ego ahead lead behind rear stage]. rewrite Tau, (place_last V (dt W) n i p), Own.
    specialize (Le (dt W + t)). pose proof (the_leader_in_a_step _ _ y f (dt W) t Hc (Rlt_le _ _ Hh) Ht L).
    replace (tau + dt W + t) with (tau + (dt W + t)) by ring. lra.
Qed.

(** The test of such a plan suffices for every state within the bounds. *)
Theorem a_plan_that_passes_while_waiting_covers V W (s : state V) b p after last : valid W -> class W = Fires -> sound V (dt W) ->
  within s b -> stage s = Waiting -> 0 <= speed V (ego s) ->
  passes_while_waiting W (ego s) b p after last -> covers W s (Wait p after).
Proof.
  intros Val Cl So [Ga [Le [Be [Re Re']]]] St Sp P.
  apply (invariant_covers V W (fun s' rest => executes W s' rest \/ exists n, waits W (ego s) b p after last n s' rest)).
  - intros s1 p1 y f z q s2 [Ex | [n Wa]] Step.
    + destruct (executes_on V W s1 s2 p1 y f z q Val Ex Step). tauto.
    + destruct (fired W s1) eqn:Fi.
      * pose proof (waits_and_fires V W (ego s) b p after last n s1 p1 Val Cl P Wa Fi) as Ex.
        destruct (executes_on V W s1 s2 p1 y f z q Val Ex Step). tauto.
      * destruct (waits_on V W (ego s) b p after last n s1 s2 p1 y f z q Val Cl So (proj1 Re) P Wa Fi Step). split; [assumption |]. right.
        exists (S n). assumption.
  - right. exists O. split; [exists p, after; auto |]. split; [exact St |]. split; [reflexivity |].
    split; [destruct last; [apply Nat.le_0_l | exact I] |]. split; [| split; [exact Sp |]].
    + unfold possible, slowest, fastest, nearest, remotest, line. simpl.
      rewrite !Rmult_0_l, braked_is, Rmult_0_r, Rminus_0_r, Rmax_right, Rmult_0_r by lra.
      rewrite covered_moving by lra. assert (rear s * rear s <= rear_max b * rear_max b) by (apply Rmult_le_compat; lra).
      assert (0 <= rise W * (gap_max b - behind s)) by (apply Rmult_le_pos; [apply Val | lra]). split; [lra |]. split; [lra |].
      split; [lra |]. split; [lra | exact I].
    + intros t Ht. simpl. rewrite Rmult_0_l, Rplus_0_l. destruct Val as [_ [Hc _]].
      pose proof (covered_increases (leader b) (lead s) (limit W) t Hc Le Ht). lra.
Qed.
(** * The test at samples *)

(** The farthest position is convex in the speed. *)
Lemma reached_is_convex u1 u2 x a d r t : 0 < r -> 0 <= u1 -> 0 <= u2 -> 0 <= a -> 0 <= d -> 0 <= t -> 0 <= x <= 1 ->
  reached ((1 - x) * u1 + x * u2) a d r t <= (1 - x) * reached u1 a d r t + x * reached u2 a d r t.
Proof.
  intros Hr H1 H2 Ha Hd Ht Hx. unfold reached. set (s := Rmin t d).
  assert (0 <= s <= t) as Hs by (unfold s, Rmin; destruct (Rle_dec t d); lra). assert (0 <= a * s) by (apply Rmult_le_pos; lra).
  assert (0 <= (1 - x) * u1) by (apply Rmult_le_pos; lra). assert (0 <= x * u2) by (apply Rmult_le_pos; lra).
  destruct (covered_is ((1 - x) * u1 + x * u2 + a * s) r (t - s)) as [k [Hk [_ ->]]]; try lra.
  pose proof (covered_at_least (u1 + a * s) r k (t - s) Hr Hk) as C1. pose proof (covered_at_least (u2 + a * s) r k (t - s) Hr Hk) as C2.
  apply (Rmult_le_compat_l (1 - x)) in C1; [| lra]. apply (Rmult_le_compat_l x) in C2; [| lra]. lra.
Qed.

(** Speeds in an interval, and gaps of at least [r0], up to the speed [star], and of at least [k u - l]: two points suffice. *)
Theorem two_ends_suffice V W (i : inner V) p d k l r0 r1 r2 lo star hi r u : valid W -> 0 <= d -> 0 <= lo -> 0 <= star <= hi ->
  lo <= u <= hi ->
  r1 <= k * star - l -> r2 <= k * hi - l -> r1 <= r0 \/ star <= lo ->
  stays_ahead_of_the_follower W i r1 star d p -> stays_ahead_of_the_follower W i r2 hi d p ->
  (u <= star -> r0 <= r) -> k * u - l <= r -> stays_ahead_of_the_follower W i r u d p.
Proof.
  intros [Hh [_ [_ [_ [Hb [_ [_ Ha]]]]]]] Hd Hlo Hs Hu H1 H2 Cases B1 B2 R0 R1 n t Ht.
  specialize (B1 n t Ht). specialize (B2 n t Ht). pose proof (steps_nonneg _ n t Hh (proj1 Ht)) as Hn. set (x := INR n * dt W + t) in *.
  destruct (Rle_lt_dec u star) as [S | S].
  - specialize (R0 S). pose proof (reached_increases u star (react W) d (bf W) x Hb). destruct Cases as [C | C]; [lra |].
    assert (u = star) as -> by lra. lra.
  - set (y := (u - star) / (hi - star)). assert (u = (1 - y) * star + y * hi) as E by (unfold y; field; lra).
    assert (0 <= y <= 1) as Hy.
    { unfold y, Rdiv. assert (0 < / (hi - star)) by (apply Rinv_0_lt_compat; lra). split; [apply Rmult_le_pos; lra |].
      apply (Rmult_le_reg_r (hi - star)); [lra |]. rewrite Rmult_assoc, Rinv_l; lra. }
    pose proof (reached_is_convex star hi y (react W) d (bf W) x Hb) as C. rewrite <- E in C.
    apply (Rmult_le_compat_l (1 - y)) in B1; [| lra]. apply (Rmult_le_compat_l y) in B2; [| lra].
    apply (Rmult_le_compat_l (1 - y)) in H1; [| lra]. apply (Rmult_le_compat_l y) in H2; [| lra].
    assert (k * u = k * ((1 - y) * star + y * hi)) by (rewrite E at 1; reflexivity). lra.
Qed.

Lemma speed_at_step V h : sound V h -> forall n i p, 0 <= speed V i -> 0 <= h -> 0 <= speed V (at_step V i p n).
Proof.
  intros So. induction n as [| n IH]; intros i p Hi Hh; [exact Hi |]. simpl. apply IH; [| exact Hh]. rewrite So by exact Hi.
  apply motion_of_the_ego; assumption.
Qed.

(** The gap to a follower that does not fire at a sample, and is not slower than [low], stays open until the next. *)
Theorem between_samples V W (i : inner V) b p n r u low t : valid W -> 0 <= speed V (at_step V i p n) -> possible W i b p n r u ->
  ttc W * (u - speed V (at_step V i p n)) <= r -> low <= u ->
  let least := Rmax (nearest W i b p n) (ttc W * (low - speed V (at_step V i p n))) in 0 <= least ->
  ttc W * (margin_behind W + (rise W + Rmax 0 (- held V (at_step V i p n) (p n))) * dt W * dt W / 2) <= least * (ttc W - dt W) ->
  0 <= t <= dt W -> margin_behind W <= r + travels V (at_step V i p n) (p n) t - (u * t + rise W * t * t / 2).
Proof.
  intros [Hh [_ [HT [_ [_ [_ [Hi _]]]]]]] Hv [[Us _] [[Rn _] _]] Un Lu least L0 Test Ht. unfold travels.
  set (v := speed V (at_step V i p n)) in *. set (a := held V (at_step V i p n) (p n)) in *.
  destruct (motion_of_the_ego v a t Hv (proj1 Ht)) as [X _]. pose proof (Rmax_l 0 (- a)) as D0. set (d := Rmax 0 (- a)) in *.
  assert (ttc W * (low - v) <= ttc W * (u - v)) by (apply Rmult_le_compat_l; lra).
  assert (least <= r) as Lr by (apply Rmax_lub; lra).
  assert (least * (ttc W - dt W) <= r * (ttc W - dt W)) as Lr' by (apply Rmult_le_compat_r; lra).
  assert (ttc W * ((u - v) * t) <= r * dt W) as Cl.
  { rewrite <- Rmult_assoc. destruct (Rle_lt_dec u v) as [N | N].
    - assert (0 <= ttc W * (v - u)) by (apply Rmult_le_pos; lra). assert (0 <= ttc W * (v - u) * t) by (apply Rmult_le_pos; lra).
      assert (0 <= r * dt W) by (apply Rmult_le_pos; lra). lra.
    - assert (0 <= ttc W * (u - v)) by (apply Rmult_le_pos; lra). apply Rmult_le_compat; lra. }
  assert ((rise W + d) * t * t <= (rise W + d) * dt W * dt W) as Sq.
  { rewrite !Rmult_assoc. apply Rmult_le_compat_l; [lra |]. apply Rmult_le_compat; lra. }
  assert (ttc W * (margin_behind W + (rise W + d) * dt W * dt W / 2) <= ttc W * (r - (u - v) * t)) as M by lra.
  apply Rmult_le_reg_l in M; lra.
Qed.

(** The worst follower that fires at the [n]th sample: B at one speed, or at two. *)
Definition ends_pass {V} (W : world) (i : inner V) (b : bounds) (p q : nat -> R) (n : nat) : Prop :=
  let v := speed V (at_step V i p n) in
  exists lo hi, (lo <= slowest W b n \/ ttc W * (lo - v) <= nearest W i b p n) /\
  (fastest W b n <= hi \/ n <> O /\ dt W < ttc W /\ remotest W i b p n <= line W i b p n hi) /\
  (stays_ahead_of_the_follower W (at_step V i p n) (nearest W i b p n) hi (rho W) q \/
   exists star r1 r2, 0 <= lo /\ 0 <= star <= hi /\ r1 <= line W i b p n star /\ r2 <= line W i b p n hi /\
     (r1 <= nearest W i b p n \/ star <= lo) /\
    stays_ahead_of_the_follower W (at_step V i p n) r1 star (rho W) q /\ stays_ahead_of_the_follower W (at_step V i p n) r2 hi (rho W) q).

Lemma line_is_affine {V} (W : world) (i : inner V) b p n : exists k l, (n <> O -> k = ttc W - dt W) /\ forall u,
  line W i b p n u = k * u - l.
Proof.
  destruct n as [| n].
  - exists 0, (- gap_min b). split; [congruence |]. intros u. simpl. ring.
  - set (x := ttc W * speed V (at_step V i p n) - travels V (at_step V i p n) (p n) (dt W) + rise W * dt W * dt W / 2).
    exists (ttc W - dt W), ((ttc W - dt W) * (rise W * dt W) + x). split; [reflexivity |]. intros u. unfold line, x. ring.
Qed.

Lemma ends_suffice V W (i : inner V) b p q n r u : valid W -> 0 <= rear_min b -> ends_pass W i b p q n -> possible W i b p n r u ->
  r <= ttc W * (u - speed V (at_step V i p n)) -> stays_ahead_of_the_follower W (at_step V i p n) r u (rho W) q.
Proof.
  intros Val Ru [lo [hi [Lo [Hi Ends]]]] [[Us Uf] [[Rn Rr] [Li _]]] Fi. assert (Val' := Val). destruct Val' as [Hh [_ [HT [Hrho _]]]].
  destruct (line_is_affine W i b p n) as [k [l [Hk L]]].
  assert (lo <= u) as Hlo.
  { destruct Lo as [Lo | Lo]; [lra |]. assert (ttc W * (lo - speed V (at_step V i p n)) <= ttc W * (u - speed V (at_step V i p n))) as M
      by lra.
    apply Rmult_le_reg_l in M; lra. }
  assert (u <= hi) as Hhi.
  { destruct Hi as [Hi | [N [Lt Hi]]]; [lra |]. assert (line W i b p n u <= line W i b p n hi) as M by lra. rewrite !L, (Hk N) in M.
    apply (Rmult_le_reg_l (ttc W - dt W)); lra. }
  assert (0 <= u). { pose proof (braked_nonneg (rear_min b) (fall W) (INR n * dt W)). unfold slowest in Us. lra. }
  destruct Ends as [B | [star [r1 [r2 [L0 [Hs [H1 [H2 [Cases [B1 B2]]]]]]]]]].
  - apply (bounds_behind_suffice V W _ (nearest W i b p n) r hi u (rho W) (rho W)); try assumption; lra.
  - rewrite L in H1, H2, Li. apply (two_ends_suffice V W _ q (rho W) k l (nearest W i b p n) r1 r2 lo star hi r u); try assumption;
      intros; lra.
Qed.

(** What the filter tests at a sample, for the followers that fire there and for those that wait. *)
Definition passes_at {V} (W : world) (i : inner V) (b : bounds) (p q : nat -> R) (n : nat) : Prop :=
  ttc W * (fastest W b n - speed V (at_step V i p n)) <= nearest W i b p n \/
  (forall k t, 0 <= t <= dt W -> margin_ahead W <= gap b + covered (leader b) (limit W) (INR n * dt W + (INR k * dt W + t)) -
    place V i p (dt W) n - drives V (at_step V i p n) q (dt W) k t) /\ ends_pass W i b p q n.
Definition passes_after {V} (W : world) (i : inner V) (b : bounds) (p : nat -> R) (n : nat) : Prop :=
  (forall t, 0 <= t <= dt W -> margin_ahead W <= gap b + covered (leader b) (limit W) (INR n * dt W + t) - drives V i p (dt W) n t) /\
  exists low, (low <= slowest W b n \/ speed V (at_step V i p n) <= 0 /\ low <= creep W) /\
  let least := Rmax (nearest W i b p n) (ttc W * (low - speed V (at_step V i p n))) in 0 <= least /\
  ttc W * (margin_behind W + (rise W + Rmax 0 (- held V (at_step V i p n) (p n))) * dt W * dt W / 2) <= least * (ttc W - dt W).

(** At the sample [last] each follower has fired. *)
Definition all_have_fired {V} (W : world) (i : inner V) (b : bounds) (p : nat -> R) (last : nat) : Prop :=
  remotest W i b p last < ttc W * (slowest W b last - speed V (at_step V i p last)).

Lemma passes_at_suffices V W (i : inner V) b p q n r u : valid W -> 0 <= rear_min b -> passes_at W i b p q n -> possible W i b p n r u ->
  r < ttc W * (u - speed V (at_step V i p n)) -> safe_if_it_fires W i b p q n r u.
Proof.
  intros Val Ru Pa Po Fi. assert (Val' := Val). destruct Val' as [Hh [_ [HT _]]]. assert (Po' := Po). destruct Po' as [[Us Uf] [[Rn _] _]].
  destruct Pa as [No | [A B]].
  - assert (ttc W * (u - speed V (at_step V i p n)) <= ttc W * (fastest W b n - speed V (at_step V i p n))) by (apply Rmult_le_compat_l;
      lra). lra.
  - split; [exact A |]. apply (ends_suffice V W i b p q n r u); try assumption. lra.
Qed.

Lemma passes_after_suffices V W (i : inner V) b p n r u : valid W -> 0 <= speed V (at_step V i p n) -> passes_after W i b p n ->
  possible W i b p n r u -> ttc W * (u - speed V (at_step V i p n)) <= r -> 0 < speed V (at_step V i p n) \/ creep W <= u ->
  safe_if_it_waits W i b p n r u.
Proof.
  intros Val Hv [A [low [Low [L0 B]]]] Po Un Creep t Ht. split; [exact (A t Ht) |].
  apply (between_samples V W i b p n r u low t); try assumption. destruct Po as [[Us _] _]. destruct Low; lra.
Qed.

Theorem the_test_at_samples_suffices V W (i : inner V) b p after last : valid W -> sound V (dt W) -> 0 <= speed V i -> 0 <= rear_min b ->
  all_have_fired W i b p last -> (forall n, (n < last)%nat -> passes_after W i b p n) -> (forall n, (n <= last)%nat ->
    passes_at W i b p (after n) n) ->
  passes_while_waiting W i b p after (Some last).
Proof.
  intros Val So Sp Ru Late After At n Hn r u Po. assert (Val' := Val). destruct Val' as [Hh [_ [HT _]]].
  pose proof (speed_at_step V (dt W) So n i p Sp (Rlt_le _ _ Hh)) as Hv.
  split; [exact (passes_at_suffices V W i b p (after n) n r u Val Ru (At n Hn) Po) |]. intros Un Creep.
  assert (n <> last) as N.
  { intros ->. unfold all_have_fired in Late. destruct Po as [[Us _] [[_ Rr] _]].
    assert (ttc W * (slowest W b last - speed V (at_step V i p last)) <= ttc W * (u - speed V (at_step V i p last))) by (apply
      Rmult_le_compat_l; lra). lra. }
  split; [congruence |]. apply passes_after_suffices; try assumption. apply After. apply le_lt_eq_dec in Hn.
  destruct Hn; [assumption | contradiction].
Qed.

Lemma drives_same V i h t n p p' : (forall j, p j = p' j) -> drives V i p h n t = drives V i p' h n t.
Proof.
  revert i p p'. induction n as [| n IH]; intros i p p' E.
  - unfold drives, place, at_step, travels. rewrite E. reflexivity.
  - rewrite !drives_later, E. f_equal. apply IH. intros j. apply E.
Qed.

Lemma covered_grows u e s t : 0 <= e -> 0 <= u -> 0 <= s <= t -> covered u e s <= covered u e t.
Proof.
  intros He Hu Hs. replace t with (s + (t - s)) by ring. rewrite (covered_slower_on u e s (t - s)) by lra.
  pose proof (covered_slower_increases 0 (braked u e s) e (t - s) He (conj (Rle_refl 0) (braked_nonneg u e s))).
  destruct He as [He | <-].
  - rewrite (covered_stopped 0 e (t - s)) in H by nra. lra.
  - rewrite covered_moving in H by lra. lra.
Qed.

(** If the first commands end in standstill, one test stands for all later samples: the leader is not nearer, and the follower was not
    slower than [creep] at the sample before it fires. *)
Theorem a_test_at_standstill_suffices V W (i i1 : inner V) b p after q N hi : valid W -> sound V (dt W) -> 0 <= speed V i ->
  0 <= rear_min b ->
  (forall n, (N <= n)%nat -> at_step V i p n = i1 /\ held V i1 (p n) = 0) -> speed V i1 = 0 ->
  (forall n j, (N < n)%nat -> after n j = q j) ->
  (forall n, (n <= N)%nat -> passes_after W i b p n /\ passes_at W i b p (after n) n) ->
  0 <= leader b -> margin_ahead W <= gap b + covered (leader b) (limit W) (INR N * dt W) - place V i p (dt W) N ->
  (forall k t, 0 <= t <= dt W -> margin_ahead W <=
    gap b + covered (leader b) (limit W) (INR N * dt W + (INR k * dt W + t)) - place V i p (dt W) N - drives V i1 q (dt W) k t) ->
  let gap_at u := (ttc W - dt W) * (u - rise W * dt W) - rise W * dt W * dt W / 2 in
  let low := creep W - fall W * dt W in 0 <= low <= hi -> dt W < ttc W -> (remotest W i b p N <= gap_at hi \/
    rear_max b * rear_max b + 2 * rise W * (gap_max b + place V i p (dt W) N) <= hi * hi /\ 0 <= gap_at low) ->
  stays_ahead_of_the_follower W i1 (gap_at low) low (rho W) q -> stays_ahead_of_the_follower W i1 (gap_at hi) hi (rho W) q ->
  margin_behind W + rise W * dt W * dt W / 2 <= creep W * (ttc W - dt W) ->
  passes_while_waiting W i b p after None.
Proof.
  intros Val So Sp Ru Stand Zero Same Before Lead A0 A gap_at low Low Lt Hi B1 B2 Creep n _ r u Po. assert (Val' := Val).
  destruct Val' as [Hh [Hc [HT [Hr [Hb [Hf [Hri Ha]]]]]]].
  pose proof (speed_at_step V (dt W) So n i p Sp (Rlt_le _ _ Hh)) as Hv.
  destruct (Nat.le_gt_cases n N) as [E | E].
  { destruct (Before n E) as [Af At]. split; [exact (passes_at_suffices V W i b p (after n) n r u Val Ru At Po) |].
    intros Un Cr. split; [discriminate |]. apply passes_after_suffices; assumption. }
  assert (forall t, travels V i1 (p n) t = 0) as T0.
  { intros t. destruct (Stand n (Nat.lt_le_incl _ _ E)) as [_ H]. unfold travels, moved. rewrite Zero, H.
    destruct (Rle_dec 0 (0 + 0 * t)); [field | exfalso; lra]. }
  assert (forall m, (N <= m)%nat -> place V i p (dt W) m = place V i p (dt W) N) as Pl.
  { intros m Hm. induction Hm as [| m Hm IH]; [reflexivity |]. rewrite place_last, IH. destruct (Stand m Hm) as [-> H].
    unfold travels, moved. rewrite Zero, H.
    destruct (Rle_dec 0 (0 + 0 * dt W)); [field | exfalso; lra]. }
  assert (INR N * dt W <= INR n * dt W) as Later by (apply Rmult_le_compat_r; [lra | apply le_INR; apply Nat.lt_le_incl; exact E]).
  assert (forall x, 0 <= x -> covered (leader b) (limit W) (INR N * dt W + x) <= covered (leader b) (limit W) (INR n * dt W + x)) as St.
  { intros x Hx. apply covered_grows; [lra | exact Lead |]. pose proof (Rmult_le_pos _ _ (pos_INR N) (Rlt_le _ _ Hh)). lra. }
  destruct (Stand n (Nat.lt_le_incl _ _ E)) as [Is H0]. destruct Po as [[Us Uf] [[Rn Rr] [Li [En Lo]]]].
  destruct n as [| k]; [inversion E |].
  assert (N <= k)%nat as Hk by (apply le_S_n; exact E). destruct (Stand k Hk) as [Isk H0k].
  unfold line in Li. rewrite Isk, Zero in Li, Lo. unfold travels, moved in Li. rewrite Zero, H0k in Li.
  destruct (Rle_dec 0 (0 + 0 * dt W)) in Li; [| exfalso; lra].
  assert (gap_at u <= r) as Li' by (unfold gap_at; lra). destruct Lo as [Lo | Lo]; [lra |]. fold low in Lo. unfold safe_if_it_fires.
  rewrite Is. split.
  - intros _. split.
    + intros k' t Ht. rewrite (Pl (S k)) by exact (Nat.lt_le_incl _ _ E).
      specialize (St (INR k' * dt W + t) (steps_nonneg _ k' t Hh (proj1 Ht))).
      rewrite (drives_same V i1 (dt W) t k' (after (S k)) q) by (intros j; apply Same; exact E). specialize (A k' t Ht). lra.
    + assert (gap_at low <= gap_at u) as Lu by (unfold gap_at;
        assert ((ttc W - dt W) * low <= (ttc W - dt W) * u) by (apply Rmult_le_compat_l; lra); lra).
      assert (u <= hi) as Uh.
      { unfold remotest in *. rewrite (Pl (S k) (Nat.lt_le_incl _ _ E)) in Rr, En. destruct Hi as [Hi | [Hi G0]].
        - assert (0 <= INR N * dt W) by (apply Rmult_le_pos; [apply pos_INR | lra]).
          pose proof (covered_grows (rear_min b) (fall W) (INR N * dt W) (INR (S k) * dt W) Hf Ru).
          apply (Rmult_le_reg_l (ttc W - dt W)); [lra |]. unfold gap_at in *. lra.
        - assert (0 <= rise W * r) by (apply Rmult_le_pos; lra). apply Rnot_lt_le. intros N0.
          assert (hi * hi < u * u) by (apply Rmult_le_0_lt_compat; lra). lra. }
      intros k' t Ht. rewrite (drives_same V i1 (dt W) t k' (after (S k)) q) by (intros j; apply Same; exact E). revert k' t Ht.
      apply (two_ends_suffice V W i1 q (rho W) (ttc W - dt W) ((ttc W - dt W) * (rise W * dt W) + rise W * dt W * dt W / 2)
        r (gap_at low) (gap_at hi) low low hi r u); try assumption; unfold gap_at in *; lra.
  - intros Un Cr. split; [discriminate |]. intros t Ht. rewrite Zero in *. destruct Cr as [Cr | Cr]; [lra |]. unfold drives.
    rewrite Is, T0, (Pl (S k)) by exact (Nat.lt_le_incl _ _ E).
    pose proof (St t (proj1 Ht)) as St0. assert (covered (leader b) (limit W) (INR N * dt W) <= covered (leader b) (limit W) (INR N * dt W
      + t)) as St1.
    { apply covered_grows; [lra | exact Lead |]. pose proof (Rmult_le_pos _ _ (pos_INR N) (Rlt_le _ _ Hh)). lra. }
    split; [lra |]. assert (ttc W * u - u * dt W <= r - u * t).
    { assert (u * t <= u * dt W) by (apply Rmult_le_compat_l; [unfold low in *; pose proof (Rmult_le_pos _ _ Hf (Rlt_le _ _ Hh));
        lra | lra]). lra. }
    assert (creep W * (ttc W - dt W) <= u * (ttc W - dt W)) by (apply Rmult_le_compat_r; lra).
    assert (rise W * t * t <= rise W * dt W * dt W) by (rewrite !Rmult_assoc; apply Rmult_le_compat_l; [lra | apply Rmult_le_compat;
      lra]). lra.
Qed.

(** A follower that neither accelerates nor slows, exactly observed: its speed and its gap at every sample are known, so [k0] = [k1]. *)
Theorem a_coasting_follower_is_known V W (i : inner V) b p n r u : fall W = 0 -> rise W = 0 -> 0 <= rear_min b -> rear_min b = rear_max b ->
  gap_min b = gap_max b -> possible W i b p n r u -> u = rear_max b /\ r = gap_max b + place V i p (dt W) n - rear_max b * (INR n * dt W).
Proof.
  intros F0 R0 Ru E E' [[Us Uf] [[Rn Rr] _]]. unfold slowest, fastest, nearest, remotest in *. rewrite F0 in *. rewrite R0, E, E' in *.
  rewrite braked_is, Rmult_0_l, Rminus_0_r, Rmax_right in Us by lra. rewrite covered_moving in Rr by lra. lra.
Qed.
(** * Followers that react *)

Lemma gains_throughout a r q d h : 0 <= a -> 0 < r -> 0 <= d -> (forall t, 0 <= t <= h -> 0 <= q t) ->
  gains_at_most a q 0 (Rmin h d) -> brakes_at_least r q d h -> gains_at_most a q 0 h.
Proof.
  intros Ha Hr Hd Pos G B s t Hs Ht.
  assert (forall s t, d <= s <= t -> t <= h -> 0 <= s -> q t <= q s) as Falls.
  { intros x y Hx Hy Hx0. apply Rle_trans with (Rmax 0 (q x - r * (y - x))); [apply B; lra |].
    apply Rmax_lub; [apply Pos; lra |]. assert (0 <= r * (y - x)) by (apply Rmult_le_pos; lra). lra. }
  destruct (Rle_lt_dec t d) as [E | E]; [apply G; [lra | apply Rmin_glb; lra] |].
  destruct (Rle_lt_dec d s) as [F | F].
  - assert (q t <= q s) by (apply Falls; lra). assert (0 <= a * (t - s)) by (apply Rmult_le_pos; lra). lra.
  - assert (q t <= q d) by (apply Falls; lra).
    assert (q d <= q s + a * (d - s)) by (apply G; [lra | apply Rmin_glb; lra]).
    assert (0 <= a * (t - d)) by (apply Rmult_le_pos; lra). lra.
Qed.

(** A plan that brakes visibly from the step [n0] on; before, commands that were given earlier are pending. *)
Theorem a_plan_that_brakes_covers V W (s : state V) p n0 : valid W -> class W = Reacts -> rise W <= react W -> 0 <= due W s <= rho W ->
  (forall j, (n0 <= j)%nat -> visible V (at_step V (ego s) p j) (p j) = true) ->
  stays_behind_the_leader W (ego s) (ahead s) (lead s) p ->
  stays_ahead_of_the_follower W (ego s) (behind s) (rear s) (INR n0 * dt W + rho W) p -> covers W s (Go p).
Proof.
  intros Val Cl Ri Du Vi A B.
  apply (invariant_covers V W (fun s rest => executes W s rest \/ exists p m, rest = Go p /\ 0 <= due W s <= rho W /\
    (forall j, (m <= j)%nat -> visible V (at_step V (ego s) p j) (p j) = true) /\
    stays_behind_the_leader W (ego s) (ahead s) (lead s) p /\
    stays_ahead_of_the_follower W (ego s) (behind s) (rear s) (INR m * dt W + rho W) p)); [| right; exists p, n0; tauto].
  clear s p n0 Du Vi A B. intros s rest y f z q s' I St.
  assert (executes W s rest -> apart W s (command (resolve W s rest)) y z /\ (executes W s' (tail (resolve W s rest)) \/ exists p m,
    tail (resolve W s rest) = Go p /\ 0 <= due W s' <= rho W /\
    (forall j, (m <= j)%nat -> visible V (at_step V (ego s') p j) (p j) = true) /\
    stays_behind_the_leader W (ego s') (ahead s') (lead s') p /\
    stays_ahead_of_the_follower W (ego s') (behind s') (rear s') (INR m * dt W + rho W) p)) as Done.
  { intros Ex. destruct (executes_on V W s s' rest y f z q Val Ex St). tauto. }
  destruct I as [Ex | [p [m [-> [Du [Vi [A B]]]]]]]; [exact (Done Ex) |].
  assert (St' := St). destruct St' as [_ [[M [Q0 F]] E']]. assert (Val' := Val). destruct Val' as [Hh [Hc [_ [Hr [Hb [_ [Hri Ha]]]]]]].
  assert (forall t, 0 <= t <= dt W -> 0 <= q t) as Qp by apply M. assert (0 <= rear s) as Ru by (rewrite <- Q0; apply Qp; lra).
  destruct m as [| m].
  { apply Done. exists p. rewrite Cl. split; [reflexivity |]. split; [lra |]. split; [intros n; apply Vi, Nat.le_0_l |]. split; [exact A |].
    apply (bounds_behind_suffice V W (ego s) (behind s) (behind s) (rear s) (rear s) (INR 0 * dt W + rho W)); try assumption; simpl; lra. }
  clear Done. cbn [resolve command tail] in *. destruct (A_in_a_step V W s s' p y f z q Val St A) as [A0 A1].
  assert (gains_at_most (react W) q 0 (dt W) /\ 0 <= due W s' <= rho W) as [Ga Du'].
  { unfold due. destruct (alarmed W s (p O)).
    - destruct F as [Ga [Br ->]]. split; [apply (gains_throughout (react W) (bf W) q (due W s) (dt W)); try assumption; try lra |].
      split; [apply Rmax_l | apply Rmax_lub; lra].
    - destruct F as [Ga [-> _]]. split; [| lra]. intros x t Hx Ht. specialize (Ga x t Hx Ht).
      assert (rise W * (t - x) <= react W * (t - x)) by (apply Rmult_le_compat_r; lra). lra. }
  set (d := INR (S m) * dt W + rho W) in *. assert (d = dt W + (INR m * dt W + rho W)) as Ed by (unfold d; rewrite S_INR; ring).
  pose proof (steps_nonneg (dt W) m (rho W) Hh Hr) as Hd'.
  assert (forall t, 0 <= t <= dt W -> z t <= reached (rear s) (react W) d (bf W) t /\
    q t <= speed_reached (rear s) (react W) d (bf W) t) as Z.
  { intros t Ht. rewrite <- Q0. apply the_follower_is_bounded with (h := dt W); try assumption; try lra.
    - rewrite Rmin_left by lra. exact Ga.
    - intros x x' Hx Hx'. assert (x = x') as -> by lra. replace (x' - x') with 0 by ring. rewrite Rmult_0_r, Rminus_0_r. apply Rmax_r. }
  split.
  - intros t Ht. split; [exact (A0 t Ht) |]. specialize (B O t Ht). unfold drives in B. simpl in B.
    replace (0 * dt W + t) with t in B by ring.
    destruct (Z t Ht). unfold travels in B. unfold own. lra.
  - right. exists (later p), m. split; [reflexivity |]. split; [exact Du' |].
    split; [intros j Hj; rewrite E'; exact (Vi (S j) (le_n_S _ _ Hj)) |]. split; [exact A1 |].
    intros n t Ht. specialize (B (S n) t Ht). rewrite drives_later, S_INR in B. rewrite E'. simpl.
    replace ((INR n + 1) * dt W + t) with (dt W + (INR n * dt W + t)) in B by ring.
    pose proof (steps_nonneg _ n t Hh (proj1 Ht)) as Hn. rewrite reached_on in B by lra. destruct (Z (dt W)) as [Z1 Q1]; [lra |].
    replace (Rmax 0 (d - dt W)) with (INR m * dt W + rho W) in B by (rewrite Rmax_right; lra).
    pose proof (reached_increases (q (dt W)) _ (react W) (INR m * dt W + rho W) (bf W) (INR n * dt W + t) Hb
      (conj (Qp (dt W) ltac:(lra)) Q1) Ha Hd' Hn).
    unfold own. unfold travels in B at 1. lra.
Qed.

(** * Plans that do not observe firing *)

(** The same commands, whether the follower has fired or not. *)
Definition same (p p' : plan) : Prop :=
  match p, p' with
  | Go c, Go c' => forall j, c j = c' j
  | Go c, Wait first after => (forall j, c j = first j) /\ forall n j, after n j = c (n + j)%nat
  | _, _ => False
  end.

Lemma same_on {V} W (s : state V) p p' : same p p' ->
  command (resolve W s p) = command (resolve W s p') /\ same (tail (resolve W s p)) (tail (resolve W s p')).
Proof.
  destruct p as [|c]; [intros []|]. destruct p' as [first after | c']; simpl.
  - intros [F A]. destruct (fired W s); simpl; unfold later.
    + split; [| intros j]; rewrite A; reflexivity.
    + split; [apply F |]. split; [intros j; apply F | intros n j; rewrite A; reflexivity].
  - intros H. split; [apply H | intros j; apply H].
Qed.

Lemma same_covers V W (s : state V) p p' : same p p' -> covers W s p' -> covers W s p.
Proof.
  intros Sa C. assert (forall s1 p1, leads W s p s1 p1 -> exists p1', leads W s p' s1 p1' /\ same p1 p1') as Follow.
  { intros s1 p1 H. induction H as [s p | s p s1 p1 y f z q s2 H IH Next]; [exists p'; split; [constructor | exact Sa] |].
    destruct (IH Sa C) as [p1' [L1 Sa1]]. destruct (same_on W s1 p1 p1' Sa1) as [E Sa2]. rewrite E in Next.
    exists (tail (resolve W s1 p1')). split; [exact (onward W s p' s1 p1' y f z q s2 L1 Next) | exact Sa2]. }
  intros s1 p1 H y f z q s2 Next. destruct (Follow s1 p1 H) as [p1' [L1 Sa1]]. destruct (same_on W s1 p1 p1' Sa1) as [E _].
  rewrite E in *. exact (C s1 p1' L1 y f z q s2 Next).
Qed.

(** Commands that do not depend on what is observed, for a follower that may have fired already. *)
Theorem a_plan_without_observation_covers V W (s : state V) b p last : valid W -> class W = Fires -> sound V (dt W) -> within s b ->
  0 <= speed V (ego s) -> 0 <= due W s <= rho W -> 0 <= rear s ->
  passes_while_waiting W (ego s) b p (fun n j => p (n + j)%nat) last ->
  stays_behind_the_leader W (ego s) (gap b) (leader b) p ->
  stays_ahead_of_the_follower W (ego s) (gap_min b) (rear_max b) (rho W) p -> covers W s (Go p).
Proof.
  intros Val Cl So Wi Sp Du Ru P A B. destruct (stage s) eqn:St.
  - apply (same_covers V W s (Go p) (Wait p (fun n j => p (n + j)%nat))); [split; reflexivity |].
    exact (a_plan_that_passes_while_waiting_covers V W s b p _ last Val Cl So Wi St Sp P).
  - destruct Wi as [Ga [Le [Be [Re Re']]]]. apply both_conditions_suffice; [exact Val |]. exists p. rewrite Cl.
    split; [reflexivity |]. split; [lra |]. split; [apply fired_is; left; congruence |].
    split; [exact (bounds_ahead_suffice V W (ego s) _ _ _ _ p Val Ga Le A) |].
    apply (bounds_behind_suffice V W (ego s) (gap_min b) (behind s) (rear_max b) (rear s) (rho W) (due W s)); try assumption; lra.
Qed.

(** * Bounds of the own course *)

(** With errors of the own speed, noise or lag, the filter computes bounds of its course under the first commands: positions,
  speeds at samples
    and deceleration. *)
Record course := Course { near : nat -> R -> R; far : nat -> R -> R; slow : nat -> R; fast : nat -> R; hard : nat -> R }.

Definition follows {V} (W : world) (i : inner V) (p : nat -> R) (c : course) : Prop := forall n,
  (forall t, 0 <= t <= dt W -> near c n t <= drives V i p (dt W) n t <= far c n t) /\
  slow c n <= speed V (at_step V i p n) <= fast c n /\ Rmax 0 (- held V (at_step V i p n) (p n)) <= hard c n.

(** Farthest positions of a follower at a sample, from the own position at the beginning less the least gap: of any,
  and of one with speed [u]
    that has not fired before. *)
Definition farthest (W : world) (b : bounds) (s : R) : R := rear_max b * s + rise W * s * s / 2.
Definition farthest_unfired (W : world) (b : bounds) (c : course) (n : nat) (u : R) : R :=
  match n with
  | O => 0
  | S k => gap_min b + far c k 0 + ttc W * fast c k - (ttc W - dt W) * (u - rise W * dt W) + rise W * dt W * dt W / 2
  end.

(** A follower that fires at position [Y] with speed [u] stays behind positions [x]. *)
Definition course_keeps (W : world) (b : bounds) (x : nat -> R -> R) (Y u : R) : Prop := forall k t, 0 <= t <= dt W ->
  margin_behind W <= gap_min b + x k t - Y - reached u (react W) (rho W) (bf W) (INR k * dt W + t).

Definition course_ends (W : world) (b : bounds) (c : course) (x : nat -> R -> R) (n : nat) : Prop := exists lo hi,
  (lo <= slowest W b n \/ ttc W * (lo - slow c n) <= gap_min b + near c n 0 - farthest W b (INR n * dt W)) /\
  (fastest W b n <= hi \/ n <> O /\ dt W < ttc W /\
    farthest_unfired W b c n hi <= gap_min b - gap_max b + covered (rear_min b) (fall W) (INR n * dt W)) /\
  0 <= hi /\
  (course_keeps W b x (farthest W b (INR n * dt W)) hi \/
   exists star Y1 Y2, 0 <= lo /\ 0 <= star <= hi /\ farthest_unfired W b c n star <= Y1 /\ farthest_unfired W b c n hi <= Y2 /\
    (farthest W b (INR n * dt W) <= Y1 \/ star <= lo) /\ course_keeps W b x Y1 star /\ course_keeps W b x Y2 hi).

(** The test at a sample: [x] and [y] bound the course if the follower fires there. *)
Definition course_at (W : world) (b : bounds) (c : course) (x y : nat -> R -> R) (n : nat) : Prop :=
  ttc W * (fastest W b n - slow c n) <= gap_min b + near c n 0 - farthest W b (INR n * dt W) \/
  (forall k t, 0 <= t <= dt W ->
    margin_ahead W <= gap b + covered (leader b) (limit W) (INR n * dt W + (INR k * dt W + t)) - y k t) /\ course_ends W b c x n.

Definition course_after (W : world) (b : bounds) (c : course) (n : nat) : Prop :=
  (forall t, 0 <= t <= dt W -> margin_ahead W <= gap b + covered (leader b) (limit W) (INR n * dt W + t) - far c n t) /\
  ((forall t, 0 <= t <= dt W -> margin_behind W <= gap_min b + near c n t - farthest W b (INR n * dt W + t)) \/
   exists low, (low <= slowest W b n \/ fast c n <= 0 /\ low <= creep W) /\
    let least := Rmax (gap_min b + near c n 0 - farthest W b (INR n * dt W)) (ttc W * (low - fast c n)) in 0 <= least /\
    ttc W * (margin_behind W + (rise W + hard c n) * dt W * dt W / 2) <= least * (ttc W - dt W)).

Definition course_last (W : world) (b : bounds) (c : course) (last : nat) : Prop :=
  gap_max b + far c last 0 - covered (rear_min b) (fall W) (INR last * dt W) < ttc W * (slowest W b last - fast c last).

Lemma course_at_a_sample V W (i : inner V) p c n : valid W -> 0 <= speed V (at_step V i p n) -> follows W i p c ->
  near c n 0 <= place V i p (dt W) n <= far c n 0.
Proof.
  intros [Hh _] Hv Fo. destruct (Fo n) as [X _]. specialize (X 0 (conj (Rle_refl 0) (Rlt_le _ _ Hh))).
  unfold drives, travels, moved in X. destruct (Rle_dec 0 (speed V (at_step V i p n) + held V (at_step V i p n) (p n) * 0)); lra.
Qed.

Lemma course_keeps_behind V W (i : inner V) b x Y u q P : (forall k t, 0 <= t <= dt W -> x k t <= P + drives V i q (dt W) k t) ->
  course_keeps W b x Y u -> stays_ahead_of_the_follower W i (gap_min b + P - Y) u (rho W) q.
Proof. intros X K k t Ht. specialize (X k t Ht). specialize (K k t Ht). lra. Qed.

Lemma course_ends_suffice V W (i : inner V) b p q c x n r u : valid W -> 0 <= rear_min b -> (forall m, 0 <= speed V (at_step V i p m)) ->
  follows W i p c -> (forall k t, 0 <= t <= dt W -> x k t <= place V i p (dt W) n + drives V (at_step V i p n) q (dt W) k t) ->
  course_ends W b c x n -> possible W i b p n r u -> r < ttc W * (u - speed V (at_step V i p n)) ->
  stays_ahead_of_the_follower W (at_step V i p n) r u (rho W) q.
Proof.
  intros Val Ru Hv Fo X [lo [hi [Lo [Hi [Hhi0 Ends]]]]] [[Us Uf] [[Rn Rr] [Li _]]] Fi. assert (Val' := Val).
  destruct Val' as [Hh [_ [HT [Hrho _]]]]. pose proof (course_at_a_sample V W i p c n Val (Hv n) Fo) as Px.
  destruct (Fo n) as [_ [[Sl _] _]]. unfold nearest, remotest in Rn, Rr. fold (farthest W b (INR n * dt W)) in Rn.
  set (P := place V i p (dt W) n) in *. set (tau := INR n * dt W) in *.
  assert (gap_min b + P - farthest_unfired W b c n u <= r) as Li'.
  { destruct n as [| k]; [unfold line in Li; unfold farthest_unfired, P; simpl; lra |].
    pose proof (course_at_a_sample V W i p c k Val (Hv k) Fo) as Pk. destruct (Fo k) as [_ [[_ Fk] _]].
    assert (ttc W * speed V (at_step V i p k) <= ttc W * fast c k) by (apply Rmult_le_compat_l; lra).
    unfold line in Li. unfold farthest_unfired, P. rewrite place_last. lra. }
  assert (lo <= u) as Hlo.
  { destruct Lo as [Lo | Lo]; [lra |].
    assert (ttc W * (u - speed V (at_step V i p n)) <= ttc W * (u - slow c n)) by (apply Rmult_le_compat_l; lra).
    assert (ttc W * (lo - slow c n) <= ttc W * (u - slow c n)) as M by lra. apply Rmult_le_reg_l in M; lra. }
  assert (u <= hi) as Hhi.
  { destruct Hi as [Hi | [N [Lt Hi]]]; [lra |]. destruct n as [| k]; [congruence |].
    assert (farthest_unfired W b c (S k) hi <= farthest_unfired W b c (S k) u) as M by lra. unfold farthest_unfired in M.
    apply (Rmult_le_reg_l (ttc W - dt W)); lra. }
  assert (0 <= u). { pose proof (braked_nonneg (rear_min b) (fall W) tau). unfold slowest in Us. fold tau in Us. lra. }
  destruct Ends as [K | [star [Y1 [Y2 [L0 [Hs [H1 [H2 [Cases [K1 K2]]]]]]]]]].
  - apply (bounds_behind_suffice V W _ (gap_min b + P - farthest W b tau) r hi u (rho W) (rho W)); try assumption; try lra.
    apply course_keeps_behind with (x := x); assumption.
  - assert (exists k l, forall v, gap_min b + P - farthest_unfired W b c n v = k * v - l) as [k [l Af]].
    { destruct n as [| m]; [exists 0, (- (gap_min b + P)); intros v; simpl; ring |].
      exists (ttc W - dt W), ((ttc W - dt W) * (rise W * dt W) - (P - far c m 0 - ttc W * fast c m) + rise W * dt W * dt W / 2).
      intros v. unfold farthest_unfired. ring. }
    apply (two_ends_suffice V W _ q (rho W) k l (gap_min b + P - farthest W b tau) (gap_min b + P - Y1) (gap_min b + P - Y2) lo star hi r
      u);
      try assumption; rewrite <- ?Af; try lra; apply course_keeps_behind with (x := x); assumption.
Qed.

Lemma moved_nonneg v a t : 0 <= v -> 0 <= t -> 0 <= moved v a t.
Proof.
  intros Hv Ht. unfold moved. destruct (Rle_dec 0 (v + a * t)) as [M | M].
  - assert (0 <= v * t) by (apply Rmult_le_pos; lra). assert (0 <= (v + a * t) * t) by (apply Rmult_le_pos; lra). lra.
  - assert (0 < - a). { apply Rnot_le_lt. intros N. apply M. assert (0 <= a * t) by (apply Rmult_le_pos; lra). lra. }
    unfold Rdiv. apply Rmult_le_pos; [apply Rle_0_sqr |]. left. apply Rinv_0_lt_compat. lra.
Qed.

Lemma course_at_suffices V W (i : inner V) b p q c x y n r u : valid W -> (forall m, 0 <= speed V (at_step V i p m)) -> 0 <= rear_min b ->
  follows W i p c ->
  (forall k t, 0 <= t <= dt W -> x k t <= place V i p (dt W) n + drives V (at_step V i p n) q (dt W) k t <= y k t) ->
  course_at W b c x y n -> possible W i b p n r u -> r < ttc W * (u - speed V (at_step V i p n)) -> safe_if_it_fires W i b p q n r u.
Proof.
  intros Val Hv Ru Fo XY At Po Fi. assert (Val' := Val). destruct Val' as [Hh [_ [HT [_ [_ [_ [Hi _]]]]]]].
  pose proof (course_at_a_sample V W i p c n Val (Hv n) Fo) as Px. destruct (Fo n) as [Dr [Sf Hd]].
  assert (Po' := Po). destruct Po' as [[Us Uf] [[Rn Rr] _]]. unfold nearest in Rn. fold (farthest W b (INR n * dt W)) in Rn.
  destruct At as [No | [A B]].
  - exfalso. assert (ttc W * (u - speed V (at_step V i p n)) <= ttc W * (fastest W b n - slow c n)) by (apply Rmult_le_compat_l; lra). lra.
  - split; [intros k t Ht; specialize (A k t Ht); specialize (XY k t Ht); lra |].
    apply (course_ends_suffice V W i b p q c x n r u); try assumption. intros k t Ht. apply XY, Ht.
Qed.

Lemma course_after_suffices V W (i : inner V) b p c n r u : valid W -> (forall m, 0 <= speed V (at_step V i p m)) -> 0 <= rear_min b ->
  follows W i p c -> course_after W b c n -> possible W i b p n r u ->
  ttc W * (u - speed V (at_step V i p n)) <= r -> 0 < speed V (at_step V i p n) \/ creep W <= u -> safe_if_it_waits W i b p n r u.
Proof.
  intros Val Hv Ru Fo [A B] Po Un Cr. assert (Val' := Val). destruct Val' as [Hh [_ [HT [_ [_ [_ [Hi _]]]]]]].
  pose proof (course_at_a_sample V W i p c n Val (Hv n) Fo) as Px. destruct (Fo n) as [Dr [Sf Hd]].
  assert (Po' := Po). destruct Po' as [[Us Uf] [[Rn Rr] _]]. unfold nearest in Rn. fold (farthest W b (INR n * dt W)) in Rn.
  intros t Ht. split; [specialize (A t Ht); specialize (Dr t Ht); lra |]. destruct B as [B | [low [Low [L0 B]]]].
  - specialize (B t Ht). specialize (Dr t Ht). unfold drives in Dr. unfold farthest in *. unfold fastest in Uf.
    assert (u * t <= (rear_max b + rise W * (INR n * dt W)) * t) by (apply Rmult_le_compat_r; lra). lra.
  - set (least := Rmax (gap_min b + near c n 0 - farthest W b (INR n * dt W)) (ttc W * (low - fast c n))) in *.
    set (exact := Rmax (nearest W i b p n) (ttc W * (low - speed V (at_step V i p n)))).
    assert (least <= exact) as Le.
    { unfold least, exact, nearest. fold (farthest W b (INR n * dt W)). apply Rmax_lub.
      - eapply Rle_trans; [| apply Rmax_l]. lra.
      - eapply Rle_trans; [| apply Rmax_r]. apply Rmult_le_compat_l; lra. }
    assert (least * (ttc W - dt W) <= exact * (ttc W - dt W)) by (apply Rmult_le_compat_r; lra).
    assert (Rmax 0 (- held V (at_step V i p n) (p n)) * dt W * dt W <= hard c n * dt W * dt W).
    { rewrite !Rmult_assoc. apply Rmult_le_compat_r; [apply Rle_0_sqr | exact Hd]. }
    assert (ttc W * (margin_behind W + (rise W + Rmax 0 (- held V (at_step V i p n) (p n))) * dt W * dt W / 2) <=
      ttc W * (margin_behind W + (rise W + hard c n) * dt W * dt W / 2)) by (apply Rmult_le_compat_l; lra).
    apply (between_samples V W i b p n r u low t Val (Hv n) Po Un); [destruct Low; lra | fold exact; lra | fold exact; lra | exact Ht].
Qed.

(** The test with bounds of the course suffices for every state of the ego vehicle whose course they bound. *)
Theorem bounds_of_the_course_suffice V W (i : inner V) b p after c (x y : nat -> nat -> R -> R) last : valid W -> sound V (dt W) ->
  0 <= speed V i -> 0 <= rear_min b -> follows W i p c ->
  (forall n k t, 0 <= t <= dt W ->
    x n k t <= place V i p (dt W) n + drives V (at_step V i p n) (after n) (dt W) k t <= y n k t) ->
  course_last W b c last -> (forall n, (n < last)%nat -> course_after W b c n) ->
  (forall n, (n <= last)%nat -> course_at W b c (x n) (y n) n) -> passes_while_waiting W i b p after (Some last).
Proof.
  intros Val So Sp Ru Fo XY Late After At n Hn r u Po. assert (Val' := Val). destruct Val' as [Hh [_ [HT _]]].
  assert (forall m, 0 <= speed V (at_step V i p m)) as Hv by (intros m; apply (speed_at_step V (dt W) So m i p Sp (Rlt_le _ _ Hh))).
  split; [exact (course_at_suffices V W i b p (after n) c (x n) (y n) n r u Val Hv Ru Fo (XY n) (At n Hn) Po) |]. intros Un Cr.
  pose proof (course_at_a_sample V W i p c n Val (Hv n) Fo) as Px. destruct (Fo n) as [_ [Sf _]]. assert (n <> last) as N.
  { intros ->. destruct Po as [[Us _] [[_ Rr] _]]. unfold course_last in Late. unfold remotest in Rr.
    assert (ttc W * (slowest W b last - speed V (at_step V i p last)) <= ttc W * (u - speed V (at_step V i p last))) by (apply
      Rmult_le_compat_l; lra).
    assert (ttc W * speed V (at_step V i p last) <= ttc W * fast c last) by (apply Rmult_le_compat_l; lra). lra. }
  split; [congruence |]. apply (course_after_suffices V W i b p c n r u Val Hv Ru Fo); try assumption. apply After.
  apply le_lt_eq_dec in Hn. destruct Hn; [assumption | contradiction].
Qed.

(** The same at standstill: one test stands for all samples after [N], from which on the course ends before [stop].
[x] and [y] bound the course
    if the follower fires later. *)
Theorem bounds_of_the_course_at_standstill_suffice V W (i : inner V) b p after c (xs ys : nat -> nat -> R -> R) x y N stop hi : valid W ->
  sound V (dt W) -> 0 <= speed V i -> 0 <= rear_min b -> follows W i p c ->
  (forall n k t, 0 <= t <= dt W ->
    xs n k t <= place V i p (dt W) n + drives V (at_step V i p n) (after n) (dt W) k t <= ys n k t) ->
  (forall n, (N <= n)%nat -> fast c n <= 0 /\ forall t, 0 <= t <= dt W -> far c n t <= stop) ->
  (forall n k t, (N < n)%nat -> 0 <= t <= dt W -> x k t <= xs n k t /\ ys n k t <= y k t) ->
  (forall n, (n <= N)%nat -> course_after W b c n /\ course_at W b c (xs n) (ys n) n) ->
  0 <= leader b -> margin_ahead W <= gap b + covered (leader b) (limit W) (INR N * dt W) - stop ->
  (forall k t, 0 <= t <= dt W ->
    margin_ahead W <= gap b + covered (leader b) (limit W) (INR N * dt W + (INR k * dt W + t)) - y k t) ->
  let gap_at u := (ttc W - dt W) * (u - rise W * dt W) - rise W * dt W * dt W / 2 in let low := creep W - fall W * dt W in
  0 <= low <= hi -> dt W < ttc W ->
  (gap_max b + stop - covered (rear_min b) (fall W) (INR N * dt W) <= gap_at hi \/
    rear_max b * rear_max b + 2 * rise W * (gap_max b + stop) <= hi * hi /\ 0 <= gap_at low) ->
  course_keeps W b x (gap_min b + stop - gap_at low) low -> course_keeps W b x (gap_min b + stop - gap_at hi) hi ->
  margin_behind W + rise W * dt W * dt W / 2 <= creep W * (ttc W - dt W) ->
  passes_while_waiting W i b p after None.
Proof.
  intros Val So Sp Ru Fo XY Stand Later Before Lead A0 A gap_at low Low Lt Hi B1 B2 Creep n _ r u Po. assert (Val' := Val).
  destruct Val' as [Hh [Hc [HT [Hr [Hb [Hf [Hri Ha]]]]]]].
  assert (forall m, 0 <= speed V (at_step V i p m)) as Hv by (intros m; apply (speed_at_step V (dt W) So m i p Sp (Rlt_le _ _ Hh))).
  destruct (Nat.le_gt_cases n N) as [E | E].
  { destruct (Before n E) as [Af At]. split;
      [exact (course_at_suffices V W i b p (after n) c (xs n) (ys n) n r u Val Hv Ru Fo (XY n) At Po) |].
    intros Un Cr. split; [discriminate |]. exact (course_after_suffices V W i b p c n r u Val Hv Ru Fo Af Po Un Cr). }
  assert (forall m, (N <= m)%nat -> speed V (at_step V i p m) = 0 /\ place V i p (dt W) m <= stop) as At.
  { intros m Hm. destruct (Stand m Hm) as [F X]. destruct (Fo m) as [_ [[_ Fm] _]]. specialize (X 0 (conj (Rle_refl 0) (Rlt_le _ _ Hh))).
    pose proof (course_at_a_sample V W i p c m Val (Hv m) Fo). pose proof (Hv m). split; lra. }
  assert (forall m t, (N <= m)%nat -> 0 <= t -> 0 <= travels V (at_step V i p m) (p m) t) as Tr.
  { intros m t Hm Ht. destruct (At m Hm) as [Z _]. unfold travels. rewrite Z. apply moved_nonneg; lra. }
  assert (INR N * dt W <= INR n * dt W) as Late by (apply Rmult_le_compat_r; [lra | apply le_INR; apply Nat.lt_le_incl; exact E]).
  assert (forall s, 0 <= s -> covered (leader b) (limit W) (INR N * dt W + s) <= covered (leader b) (limit W) (INR n * dt W + s)) as St.
  { intros s Hs. apply covered_grows; [lra | exact Lead |]. pose proof (Rmult_le_pos _ _ (pos_INR N) (Rlt_le _ _ Hh)). lra. }
  destruct (At n (Nat.lt_le_incl _ _ E)) as [Zn Pn]. destruct Po as [[Us Uf] [[Rn Rr] [Li [En Lo]]]]. destruct n as [| m]; [inversion E |].
  assert (N <= m)%nat as Hm by (apply le_S_n; exact E). destruct (At m Hm) as [Zm Pm]. pose proof (Tr m (dt W) Hm (Rlt_le _ _ Hh)) as Trm.
  unfold line in Li. rewrite Zm in Li, Lo. assert (gap_at u <= r) as Li' by (unfold gap_at; lra).
  destruct Lo as [Lo | Lo]; [lra |]. fold low in Lo. set (P := place V i p (dt W) (S m)) in *. unfold safe_if_it_fires. fold P. split.
  - intros _. split.
    + intros k t Ht. specialize (St (INR k * dt W + t) (steps_nonneg _ k t Hh (proj1 Ht))). specialize (A k t Ht).
      specialize (XY (S m) k t Ht). fold P in XY.
      destruct (Later (S m) k t E Ht). lra.
    + assert (gap_at low <= gap_at u) as Lu
        by (unfold gap_at; assert ((ttc W - dt W) * low <= (ttc W - dt W) * u) by (apply Rmult_le_compat_l; lra); lra).
      assert (u <= hi) as Uh.
      { unfold remotest in Rr. fold P in Rr. destruct Hi as [Hi | [Hi G0]].
        - assert (0 <= INR N * dt W) by (apply Rmult_le_pos; [apply pos_INR | lra]).
          pose proof (covered_grows (rear_min b) (fall W) (INR N * dt W) (INR (S m) * dt W) Hf Ru).
          apply (Rmult_le_reg_l (ttc W - dt W)); [lra |]. unfold gap_at in *. lra.
        - assert (0 <= rise W * r) by (apply Rmult_le_pos; lra). assert (rise W * P <= rise W * stop) by (apply Rmult_le_compat_l; lra).
          apply Rnot_lt_le. intros N0. assert (hi * hi < u * u) by (apply Rmult_le_0_lt_compat; lra). lra. }
      assert (forall k t, 0 <= t <= dt W -> x k t <= P + drives V (at_step V i p (S m)) (after (S m)) (dt W) k t) as X.
      { intros k t Ht. specialize (XY (S m) k t Ht). fold P in XY. destruct (Later (S m) k t E Ht). lra. }
      apply (course_keeps_behind V W (at_step V i p (S m)) b x _ low (after (S m)) P X) in B1.
      apply (course_keeps_behind V W (at_step V i p (S m)) b x _ hi (after (S m)) P X) in B2.
      apply (two_ends_suffice V W (at_step V i p (S m)) (after (S m)) (rho W) (ttc W - dt W)
        ((ttc W - dt W) * (rise W * dt W) + rise W * dt W * dt W / 2 + (stop - P)) r (gap_min b + P - (gap_min b + stop - gap_at low))
        (gap_min b + P - (gap_min b + stop - gap_at hi)) low low hi r u); try assumption; unfold gap_at in *; lra.
  - intros Un Cr. split; [discriminate |]. intros t Ht. rewrite Zn in *. destruct Cr as [Cr | Cr]; [lra |].
    destruct (Stand (S m) (Nat.lt_le_incl _ _ E)) as [_ Fa]. destruct (Fo (S m)) as [Dr _]. specialize (Fa t Ht). specialize (Dr t Ht).
    pose proof (St t (proj1 Ht)) as St0. assert (covered (leader b) (limit W) (INR N * dt W) <= covered (leader b) (limit W) (INR N * dt W
      + t)) as St1.
    { apply covered_grows; [lra | exact Lead |]. pose proof (Rmult_le_pos _ _ (pos_INR N) (Rlt_le _ _ Hh)). lra. }
    split; [lra |]. pose proof (Tr (S m) t (Nat.lt_le_incl _ _ E) (proj1 Ht)).
    assert (ttc W * u - u * dt W <= r - u * t).
    { assert (u * t <= u * dt W) by (apply Rmult_le_compat_l; [unfold low in *; pose proof (Rmult_le_pos _ _ Hf (Rlt_le _ _ Hh));
        lra | lra]). lra. }
    assert (creep W * (ttc W - dt W) <= u * (ttc W - dt W)) by (apply Rmult_le_compat_r; lra).
    assert (rise W * t * t <= rise W * dt W * dt W) by (rewrite !Rmult_assoc; apply Rmult_le_compat_l; [lra | apply Rmult_le_compat;
      lra]). lra.
Qed.

(** * The filter *)

(** The tests of a plan, for a state within the bounds of an observation. *)
Inductive passes {V} (W : world) (s : state V) : plan -> Prop :=
| passes_executing p : executes W s p -> passes W s p
| passes_waiting b p after last : class W = Fires -> within s b -> stage s = Waiting ->
    passes_while_waiting W (ego s) b p after last -> passes W s (Wait p after)
| passes_unobserved b p last : class W = Fires -> within s b -> 0 <= due W s <= rho W -> 0 <= rear s ->
    passes_while_waiting W (ego s) b p (fun n j => p (n + j)%nat) last ->
    stays_behind_the_leader W (ego s) (gap b) (leader b) p ->
    stays_ahead_of_the_follower W (ego s) (gap_min b) (rear_max b) (rho W) p -> passes W s (Go p)
| passes_braking p n0 : class W = Reacts -> rise W <= react W -> 0 <= due W s <= rho W ->
    (forall j, (n0 <= j)%nat -> visible V (at_step V (ego s) p j) (p j) = true) ->
    stays_behind_the_leader W (ego s) (ahead s) (lead s) p ->
    stays_ahead_of_the_follower W (ego s) (behind s) (rear s) (INR n0 * dt W + rho W) p -> passes W s (Go p).

Theorem a_plan_that_passes_covers V W (s : state V) p : valid W -> sound V (dt W) -> 0 <= speed V (ego s) -> passes W s p -> covers W s p.
Proof.
  intros Val So Sp [p' Ex | b p' af last Cl Wi St P | b p' last Cl Wi Du Ru P A B | p' n0 Cl Ri Du Vi A B].
  - exact (both_conditions_suffice V W s p' Val Ex).
  - exact (a_plan_that_passes_while_waiting_covers V W s b p' af last Val Cl So Wi St Sp P).
  - exact (a_plan_without_observation_covers V W s b p' last Val Cl So Wi Sp Du Ru P A B).
  - exact (a_plan_that_brakes_covers V W s p' n0 Val Cl Ri Du Vi A B).
Qed.

(** If a plan passes at the first sample, and each later plan passes or is the rest of the plan before,
  then both gaps stay open at all times. *)
Theorem no_collision_on_either_side V W (s : nat -> state V) (p : nat -> plan) (y f z q : nat -> R -> R) :
  valid W -> sound V (dt W) -> 0 <= speed V (ego (s O)) ->
  (forall n, passes W (s n) (p n) \/ exists k, n = S k /\ p n = tail (resolve W (s k) (p k))) ->
  (forall n, step W (s n) (command (resolve W (s n) (p n))) (y n) (f n) (z n) (q n) (s (S n))) ->
  forall n, apart W (s n) (command (resolve W (s n) (p n))) (y n) (z n) /\ in_S W (s n).
Proof.
  intros Val So Sp Plan Step. assert (forall n, 0 <= speed V (ego (s n))) as Sn.
  { induction n as [| n IH]; [exact Sp |]. destruct (Step n) as [_ [_ ->]]. cbn [ego]. rewrite So by exact IH.
    apply motion_of_the_ego; [exact IH | apply Rlt_le, Val]. }
  apply (the_filter_never_collides V W s p y f z q); [| exact Step]. intros n. destruct (Plan n) as [P | Rest]; [left | right; exact Rest].
  exact (a_plan_that_passes_covers V W (s n) (p n) Val So (Sn n) P).
Qed.

(** Farther is as good for the gap behind: so a plan whose commands change still passes B. *)
Theorem farther_is_as_good_behind V W (i j : inner V) r u d p p' : (forall n t, 0 <= t <= dt W ->
  drives V i p (dt W) n t <= drives V j p' (dt W) n t) ->
  stays_ahead_of_the_follower W i r u d p -> stays_ahead_of_the_follower W j r u d p'.
Proof. intros Le B n t Ht. specialize (B n t Ht). specialize (Le n t Ht). lra. Qed.

Theorem nearer_is_as_good_ahead V W (i j : inner V) g w p p' : (forall n t, 0 <= t <= dt W ->
  drives V j p' (dt W) n t <= drives V i p (dt W) n t) ->
  stays_behind_the_leader W i g w p -> stays_behind_the_leader W j g w p'.
Proof. intros Le A n t Ht. specialize (A n t Ht). specialize (Le n t Ht). lra. Qed.

(** * The level *)

Definition with_limit (W : world) (c : R) : world := World (dt W) c (margin_ahead W) (margin_behind W) (class W) (ttc W) (rho W) (bf W)
  (fall W) (rise W) (react W) (creep W).

Lemma weaker_leaders V W c c' (s : state V) p : c' <= c -> covers (with_limit W c) s p -> covers (with_limit W c') s p.
Proof.
  intros Hc. assert (forall s1 a y f z q s2, step (with_limit W c') s1 a y f z q s2 ->
    step (with_limit W c) (V := V) s1 a y f z q s2) as St.
  { intros s1 a y f z q s2 [[Y0 [F0 [Dy [Pos Lim]]]] H]. split; [| exact H]. repeat (split; [assumption |]). intros x t Hx. simpl in *.
    specialize (Lim x t Hx). assert (c' * (t - x) <= c * (t - x)) by (apply Rmult_le_compat_r; lra). lra. }
  intros C s1 p1 H y f z q s2 Next. apply (C s1 p1) with (f := f) (q := q) (s2 := s2); [| exact (St _ _ _ _ _ _ _ Next)].
  clear C y f z q s2 Next. induction H as [s p | s p s1 p1 y f z q s2 H IH Next]; [apply nowhere |].
  exact (onward (with_limit W c) s p s1 p1 y f z q s2 IH (St _ _ _ _ _ _ _ Next)).
Qed.

(** A state of S for a leader that brakes at up to [c] is one for leaders that brake less. *)
Theorem levels_below_hold V W c c' (s : state V) : c' <= c -> in_S (with_limit W c) s -> in_S (with_limit W c') s.
Proof. intros Hc [p C]. exists p. exact (weaker_leaders V W c c' s p Hc C). Qed.

(** Behind a leader that brakes at most at [c], the plan keeps each level up to [c]. *)
Theorem the_level_never_falls V W c c' (s s' : state V) p y f z q : c' <= c -> covers (with_limit W c) s p ->
  step (with_limit W c) s (command (resolve W s p)) y f z q s' -> in_S (with_limit W c') s'.
Proof.
  intros Hc C St. apply (levels_below_hold V W c c' s' Hc). exact (proj2 (two_sided V (with_limit W c) s s' p y f z q C St)).
Qed.
