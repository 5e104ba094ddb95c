(** The two-sided shield: the motion of vehicles along plans, what an evaluation of tests needs, and examples. *)

From Coq Require Import Reals Lra Psatz List.
Require Import Kernel TwoSided.
Open Scope R_scope.

(** * Vehicles *)

(** A vehicle that stands is held, unless it accelerates. *)
Definition held_at (v a : R) : R := if Rlt_dec 0 v then a else Rmax 0 a.

(** A step from the speed [v] to [v'] in which the vehicle brakes at [seen] or more, or stands all the time, is visible. *)
Definition sees (seen a v v' : R) : bool :=
  if Rle_dec a (- seen) then true else if Rle_dec (Rmax v v') 0 then true else false.

(** An actuator without delay and lag. *)
Definition direct (h seen : R) : vehicle := Vehicle R (fun v => v) held_at (fun v a => moved_speed v (held_at v a) h)
  (fun v a => sees seen a v (moved_speed v (held_at v a) h)).

Lemma moved_braking v a t : 0 <= v -> a < 0 -> moved v a t = covered v (- a) t.
Proof.
  intros Hv Ha. unfold moved, covered. destruct (Rle_dec 0 (v + a * t)); destruct (Rle_dec (- a * t) v); try (exfalso; lra); field. lra.
Qed.

Lemma moved_increases v v' a a' t : 0 <= v <= v' -> a <= a' -> 0 <= t -> moved v a t <= moved v' a' t.
Proof.
  intros Hv Ha Ht. assert (v * t <= v' * t) by (apply Rmult_le_compat_r; lra).
  destruct (Rle_lt_dec 0 a') as [P' | N'].
  - unfold moved at 2. pose proof (Rmult_le_pos _ _ P' Ht) as T'. pose proof (squared_nonneg a' t P').
    destruct (Rle_dec 0 (v' + a' * t)); [| exfalso; lra]. destruct (Rle_lt_dec 0 a) as [P | N].
    + unfold moved. pose proof (Rmult_le_pos _ _ P Ht). destruct (Rle_dec 0 (v + a * t)); [| exfalso; lra].
      assert (a * t * t <= a' * t * t) by (rewrite !Rmult_assoc; apply Rmult_le_compat_r; [apply Rle_0_sqr | lra]). lra.
    + rewrite moved_braking by lra. destruct (covered_is v (- a) t) as [s [Hs [_ ->]]]; try lra.
      pose proof (squared_nonneg (- a) s). assert (v * s <= v * t) by (apply Rmult_le_compat_l; lra). lra.
  - rewrite !moved_braking by lra. destruct (covered_is v (- a) t) as [s [Hs [_ ->]]]; try lra.
    pose proof (covered_at_least v' (- a') s t). assert (v * s <= v' * s) by (apply Rmult_le_compat_r; lra).
    pose proof (squared_nonneg (a' - a) s). lra.
Qed.

Lemma moved_speed_increases v v' a a' t : 0 <= v <= v' -> a <= a' -> 0 <= t -> 0 <= moved_speed v a t <= moved_speed v' a' t.
Proof.
  intros Hv Ha Ht. assert (a * t <= a' * t) by (apply Rmult_le_compat_r; lra). unfold moved_speed.
  destruct (Rle_dec 0 (v + a * t)); destruct (Rle_dec 0 (v' + a' * t)); lra.
Qed.

Lemma held_increases v v' a a' t : 0 <= v <= v' -> a <= a' -> 0 <= t ->
  moved v (held_at v a) t <= moved v' (held_at v' a') t /\ 0 <= moved_speed v (held_at v a) t <= moved_speed v' (held_at v' a') t.
Proof.
  intros Hv Ha Ht. unfold held_at. destruct (Rlt_dec 0 v) as [P | N]; destruct (Rlt_dec 0 v') as [P' | N']; try (exfalso; lra).
  - split; [apply moved_increases | apply moved_speed_increases]; assumption.
  - assert (v = 0) as -> by lra. destruct (Rle_lt_dec a 0) as [B | B].
    + rewrite Rmax_left by lra. assert (moved 0 0 t = 0 /\ moved_speed 0 0 t = 0) as [-> ->].
      { unfold moved, moved_speed. destruct (Rle_dec 0 (0 + 0 * t)); [split; field | exfalso; lra]. }
      destruct (moved_speed_increases v' v' a' a' t) as [M _]; try lra. split; [| lra].
      assert (moved 0 a t <= moved v' a' t) by (apply moved_increases; lra). destruct (Req_dec a 0) as [-> | Nz].
      { unfold moved in H at 1. destruct (Rle_dec 0 (0 + 0 * t)) in H; [lra | exfalso; lra]. }
      rewrite moved_braking in H by lra. rewrite covered_stopped in H by nra. replace (0 * 0 / (2 * - a)) with 0 in H by (field; lra).
      exact H.
    + rewrite Rmax_right by lra. split; [apply moved_increases | apply moved_speed_increases]; lra.
  - assert (v = 0) as -> by lra. assert (v' = 0) as -> by lra. assert (Rmax 0 a <= Rmax 0 a') by (apply Rle_max_compat_l; exact Ha).
    split; [apply moved_increases | apply moved_speed_increases]; lra.
Qed.

Theorem the_direct_vehicle_is_sound h seen : sound (direct h seen) h.
Proof. intros v a _. reflexivity. Qed.

(** A higher speed and larger commands drive farther. *)
Theorem larger_commands_drive_farther h seen t n : 0 <= h -> 0 <= t -> forall v v' p p', 0 <= v <= v' -> (forall j, p j <= p' j) ->
  drives (direct h seen) v p h n t <= drives (direct h seen) v' p' h n t.
Proof.
  intros Hh Ht. induction n as [| n IH]; intros v v' p p' Hv Hp.
  - unfold drives, place, at_step, travels. simpl. destruct (held_increases v v' (p O) (p' O) t); try assumption; [apply Hp |]. lra.
  - rewrite !drives_later. unfold travels. simpl. destruct (held_increases v v' (p O) (p' O) h) as [M Up]; try assumption; [apply Hp |].
    specialize (IH (moved_speed v (held_at v (p O)) h) (moved_speed v' (held_at v' (p' O)) h) (later p) (later p') Up (fun j => Hp (S j))).
    apply Rplus_le_compat; [exact M | exact IH].
Qed.

(** An actuator with delay and lag: a state is speed, response and pending commands. In a step the response covers [share] of its difference
    to the command that is due. *)
Definition queue (pending : list R) (a : R) : list R := pending ++ a :: nil.
Definition responds (share r : R) (pending : list R) (a : R) : R := r + share * (hd 0 (queue pending a) - r).
Definition actuator (h share seen : R) : vehicle := Vehicle (R * R * list R)
  (fun i => let '(v, _, _) := i in v)
  (fun i a => let '(v, r, l) := i in held_at v (responds share r l a))
  (fun i a => let '(v, r, l) := i in
    (moved_speed v (held_at v (responds share r l a)) h, responds share r l a, tl (queue l a)))
  (fun i a => let '(v, r, l) := i in
    let r' := responds share r l a in sees seen r' v (moved_speed v (held_at v r') h)).

Theorem the_actuator_is_sound h share seen : sound (actuator h share seen) h.
Proof. intros [[v r] l] a _. reflexivity. Qed.

(** With noise on its acceleration: a state contains the noise to come, which no plan observes. *)
Definition noisy_response (v r' noise : R) : R := if Rlt_dec 0 (Rmax v r') then r' + noise else 0.
Definition noisy_actuator (h share seen : R) : vehicle := Vehicle (R * R * list R * (nat -> R))
  (fun i => let '(v, _, _, _) := i in v)
  (fun i a => let '(v, r, l, noise) := i in noisy_response v (responds share r l a) (noise O))
  (fun i a => let '(v, r, l, noise) := i in let r' := responds share r l a in
    (moved_speed v (noisy_response v r' (noise O)) h, r', tl (queue l a), later noise))
  (fun i a => let '(v, r, l, noise) := i in let r' := responds share r l a in
    sees seen (r' + noise O) v (moved_speed v (noisy_response v r' (noise O)) h)).

Theorem the_noisy_actuator_is_sound h share seen : sound (noisy_actuator h share seen) h.
Proof. intros [[[v r] l] noise] a _. reflexivity. Qed.

(** While the vehicle moves, a step changes v + lag r by exactly h times the command. *)
Theorem lag_moves_by_the_command h share v r c : 0 < h -> 0 < share ->
  let lag := h * (1 - share) / share in let r' := r + share * (c - r) in (v + r' * h) + lag * r' = v + lag * r + h * c.
Proof. intros Hh Hs. simpl. field. lra. Qed.

Lemma standing_still h share seen b t n : 0 < h -> 0 < share <= 1 -> 0 < b -> forall r, r <= 0 ->
  drives (actuator h share seen) (0, r, nil) (fun _ => - b) h n t = 0.
Proof.
  intros Hh Hs Hb. assert (forall x, moved 0 0 x = 0) as M by (intros x; unfold moved; destruct (Rle_dec 0 (0 + 0 * x)); [field | exfalso;
    lra]).
  induction n as [| n IH]; intros r Hr.
  - unfold drives, place, at_step, travels. simpl. unfold responds, held_at. simpl. destruct (Rlt_dec 0 0); [exfalso; lra |].
    rewrite Rmax_left, M by nra. ring.
  - rewrite drives_later. unfold travels. simpl. assert (responds share r nil (- b) <= 0) as R0 by (unfold responds; simpl; nra).
    unfold held_at. destruct (Rlt_dec 0 0); [exfalso; lra |]. rewrite Rmax_left, M by exact R0.
    replace (moved_speed 0 0 h) with 0 by (unfold moved_speed; destruct (Rle_dec 0 (0 + 0 * h)); lra).
    change (later (fun _ : nat => - b)) with (fun _ : nat => - b). rewrite (IH _ R0). ring.
Qed.

(** Full braking with lag: at most as far as at once from the speed to lose, at least as far as at once. *)
Theorem full_braking_with_lag_lies_between h share seen b t n : 0 < h -> 0 < share <= 1 -> 0 < b -> 0 <= t <= h -> forall v r, 0 <= v ->
  - b <= r ->
  covered v b (INR n * h + t) <= drives (actuator h share seen) (v, r,
    nil) (fun _ => - b) h n t <= covered (to_lose b h share v r) b (INR n * h + t).
Proof.
  intros Hh Hs Hb Ht. induction n as [| n IH]; intros v r Hv Hr.
  all: set (r' := response b share r); assert (r' = r + share * (- b - r)) as Er by reflexivity.
  all: assert (- b <= r') as Hr' by (rewrite Er; assert (0 <= (1 - share) * (r + b)) by (apply Rmult_le_pos; lra); lra).
  all: assert (- b <= held_at v r') as Hheld by (unfold held_at; destruct (Rlt_dec 0 v); [lra | pose proof (Rmax_l 0 r'); lra]).
  all: assert (forall x, 0 <= x <= h -> covered v b x <= moved v (held_at v r') x <= covered (to_lose b h share v r) b x) as Between.
  1, 3: intros x Hx; split;
    [replace (covered v b x) with (moved v (- b) x) by (rewrite moved_braking by lra; f_equal; ring); apply moved_increases; lra |].
  1, 2: destruct (full_braking_through_lag b h share v r x Hb Hh Hs Hv Hr Hx) as [M _]; fold r' in M; unfold held_at;
    destruct (Rlt_dec 0 v); [exact M |];
    assert (v = 0) as -> by lra; destruct (Rle_lt_dec r' 0) as [N | N]; [| rewrite Rmax_right by lra; exact M];
      rewrite Rmax_left by exact N;
    unfold moved at 1; destruct (Rle_dec 0 (0 + 0 * x)); [| exfalso; lra]; replace (0 * x + 0 * x * x / 2) with 0 by field;
    assert (0 <= to_lose b h share 0 r) by (unfold to_lose; assert (0 <= h * (1 - share) / share * (r + b)); [| lra];
      apply Rmult_le_pos; [| lra]; unfold Rdiv; apply Rmult_le_pos; [apply Rmult_le_pos; lra | left; apply Rinv_0_lt_compat; lra]);
    pose proof (covered_at_least (to_lose b h share 0 r) b 0 x Hb); lra.
  - unfold drives, place, at_step, travels. simpl. unfold responds. simpl. rewrite <- Er. specialize (Between t Ht).
    replace (0 * h + t) with t by ring. lra.
  - rewrite drives_later, S_INR. unfold travels. simpl. unfold responds. simpl. rewrite <- Er.
    change (later (fun _ : nat => - b)) with (fun _ : nat => - b). specialize (Between h). set (v' := moved_speed v (held_at v r') h).
    assert (braked v b h <= v') as Sv.
    { replace (braked v b h) with (moved_speed v (- b) h); [apply moved_speed_increases; lra |].
      unfold moved_speed, braked. destruct (Rle_dec 0 (v + - b * h)); destruct (Rle_dec (b * h) v); lra. }
    pose proof (braked_nonneg v b h) as Bp. pose proof (steps_nonneg h n t Hh (proj1 Ht)) as Hn.
    replace ((INR n + 1) * h + t) with (h + (INR n * h + t)) by ring.
    assert (0 <= h * (1 - share) / share) as Hl.
    { unfold Rdiv. apply Rmult_le_pos; [apply Rmult_le_pos; lra | left; apply Rinv_0_lt_compat; lra]. }
    assert (0 <= to_lose b h share v r) as Hz by (unfold to_lose; assert (0 <= h * (1 - share) / share * (r + b)) by (apply Rmult_le_pos;
      lra); lra).
    rewrite (covered_on v) by lra. rewrite (covered_on (to_lose b h share v r)) by lra. split.
    + destruct (IH v' r') as [L _]; [lra | lra |]. pose proof (covered_increases (braked v b h) v' b (INR n * h + t)). lra.
    + destruct (full_braking_through_lag b h share v r h Hb Hh Hs Hv Hr) as [_ Lose]; [lra |]. fold r' in Lose.
      assert (0 <= covered (braked (to_lose b h share v r) b h) b (INR n * h + t)).
      { pose proof (covered_at_least (braked (to_lose b h share v r) b h) b 0 (INR n * h + t) Hb). lra. }
      assert (v' = 0 /\ r' <= 0 \/ v' = v + r' * h) as Cases.
      { unfold v', held_at, moved_speed. destruct (Rlt_dec 0 v) as [P | N].
        - destruct (Rle_dec 0 (v + r' * h)) as [Q | Q]; [right; reflexivity | left; split; [reflexivity |]].
          apply Rnot_lt_le. intros B. apply Q. assert (0 <= r' * h) by (apply Rmult_le_pos; lra). lra.
        - assert (v = 0) as -> by lra. destruct (Rle_lt_dec r' 0) as [B | B].
          + left. rewrite Rmax_left by exact B. destruct (Rle_dec 0 (0 + 0 * h)); split; lra.
          + right. rewrite Rmax_right by lra. assert (0 <= r' * h) by (apply Rmult_le_pos; lra). destruct (Rle_dec 0 (0 + r' * h)); lra. }
      destruct Cases as [[-> B] | Ev].
      * rewrite (standing_still h share seen b t n Hh Hs Hb r' B). lra.
      * assert (0 <= v') as Hv' by lra. destruct (IH v' r' Hv' Hr') as [_ U]. unfold to_lose in Lose, U, Between. unfold to_lose.
        assert (0 <= h * (1 - share) / share * (r' + b)) by (apply Rmult_le_pos; lra).
        rewrite (braked_is (v + h * (1 - share) / share * (r + b))), Rmax_right by lra.
        replace (v + h * (1 - share) / share * (r + b) - b * h) with (v' + h * (1 - share) / share * (r' + b)) by lra. lra.
Qed.

(** * Evaluation of A and B *)

(** On a piece on which both vehicles hold their accelerations, their distance is quadratic: its ends suffice,
  and its vertex if it lies inside. *)
Theorem ends_and_vertex_suffice m p q k T t : 0 <= t <= T -> m <= p -> m <= p + q * T + k * T * T / 2 ->
  (0 < k -> 0 <= q \/ q + k * T <= 0 \/ m <= p - q * q / (2 * k)) -> m <= p + q * t + k * t * t / 2.
Proof.
  intros Ht P E C. destruct (Rle_lt_dec k 0) as [K | K].
  - destruct (Req_dec T 0) as [Z | Z]; [assert (t = 0) as -> by lra; lra |].
    assert (0 <= (T - t) * t) by (apply Rmult_le_pos; lra).
    assert (0 <= - k * ((T - t) * t)) by (apply Rmult_le_pos; lra).
    assert ((T - t) * m <= (T - t) * p) by (apply Rmult_le_compat_l; lra).
    assert (t * m <= t * (p + q * T + k * T * T / 2)) by (apply Rmult_le_compat_l; lra).
    apply (Rmult_le_reg_l T); [lra |].
    assert (T * (p + q * t + k * t * t / 2) = (T - t) * p + t * (p + q * T + k * T * T / 2) + - k * ((T - t) * t) * T / 2) by field.
    assert (0 <= - k * ((T - t) * t) * T) by (apply Rmult_le_pos; lra). lra.
  - destruct (C K) as [Q | [Q | Q]].
    + assert (0 <= q * t) by (apply Rmult_le_pos; lra). pose proof (squared_nonneg k t). lra.
    + assert (0 <= (T - t) * (- (q + k * T))) by (apply Rmult_le_pos; lra).
      pose proof (squared_nonneg k (T - t)). lra.
    + pose proof (peak (- q) k t K). replace (- q * - q / (2 * k)) with (q * q / (2 * k)) in H by (field; lra). lra.
Qed.

Lemma held_as_commanded v a t : 0 <= v -> 0 <= t -> moved v (held_at v a) t = moved v a t /\
  moved_speed v (held_at v a) t = moved_speed v a t.
Proof.
  intros Hv Ht. unfold held_at. destruct (Rlt_dec 0 v) as [P | N]; [split; reflexivity |]. assert (v = 0) as -> by lra.
  destruct (Rle_lt_dec 0 a) as [A | A]; [rewrite Rmax_right by exact A; split; reflexivity |]. rewrite Rmax_left by lra.
  assert (0 <= - a * t) by (apply Rmult_le_pos; lra). rewrite (moved_braking 0 a) by lra. rewrite covered_stopped by lra.
  unfold moved, moved_speed.
  destruct (Rle_dec 0 (0 + 0 * t)); [| exfalso; lra]. split; [field; lra |]. destruct (Rle_dec 0 (0 + a * t)); lra.
Qed.

Lemma moved_on v a s t : 0 <= v -> 0 <= s -> 0 <= t -> moved v a (s + t) = moved v a s + moved (moved_speed v a s) a t /\
  moved_speed (moved_speed v a s) a t = moved_speed v a (s + t) /\ 0 <= moved_speed v a s.
Proof.
  intros Hv Hs Ht. destruct (Rle_lt_dec 0 a) as [A | A].
  - pose proof (Rmult_le_pos _ _ A Hs). pose proof (Rmult_le_pos _ _ A Ht). unfold moved, moved_speed.
    destruct (Rle_dec 0 (v + a * s)); [| exfalso; lra]. destruct (Rle_dec 0 (v + a * (s + t))); [| exfalso; lra].
    destruct (Rle_dec 0 (v + a * s + a * t)); [| exfalso; lra]. split; [field | split; lra].
  - assert (forall u x, moved_speed u a x = braked u (- a) x) as E.
    { intros u x. unfold moved_speed, braked. destruct (Rle_dec 0 (u + a * x)); destruct (Rle_dec (- a * x) u); lra. }
    rewrite !E. pose proof (braked_nonneg v (- a) s). rewrite !moved_braking by lra. rewrite covered_on, braked_on by lra. auto.
Qed.

(** What a vehicle holds in each step bounds its course: noise, for example. *)
Theorem accelerations_bound_the_course V h seen t n : sound V h -> 0 <= h -> 0 <= t -> forall i p low high v v',
  0 <= v <= speed V i -> speed V i <= v' -> (forall j, low j <= held V (at_step V i p j) (p j) <= high j) ->
  drives (direct h seen) v low h n t <= drives V i p h n t <= drives (direct h seen) v' high h n t.
Proof.
  intros So Hh Ht. induction n as [| n IH]; intros i p low high v v' Hv Hv' B.
  - unfold drives, place, at_step. specialize (B O). simpl in B.
    change (travels (direct h seen) v (low O) t) with (moved v (held_at v (low O)) t).
    change (travels (direct h seen) v' (high O) t) with (moved v' (held_at v' (high O)) t). unfold travels.
    destruct (held_as_commanded v (low O) t) as [-> _]; try lra. destruct (held_as_commanded v' (high O) t) as [-> _]; try lra.
    pose proof (moved_increases v (speed V i) (low O) (held V i (p O)) t).
    pose proof (moved_increases (speed V i) v' (held V i (p O)) (high O) t). lra.
  - rewrite !drives_later. pose proof (B O) as B0. simpl in B0.
    change (travels (direct h seen) v (low O) h) with (moved v (held_at v (low O)) h).
    change (travels (direct h seen) v' (high O) h) with (moved v' (held_at v' (high O)) h). unfold travels.
    change (next (direct h seen) v (low O)) with (moved_speed v (held_at v (low O)) h).
    change (next (direct h seen) v' (high O)) with (moved_speed v' (held_at v' (high O)) h).
    destruct (held_as_commanded v (low O) h) as [-> ->]; try lra. destruct (held_as_commanded v' (high O) h) as [-> ->]; try lra.
    pose proof (moved_increases v (speed V i) (low O) (held V i (p O)) h).
    pose proof (moved_increases (speed V i) v' (held V i (p O)) (high O) h).
    pose proof (moved_speed_increases v (speed V i) (low O) (held V i (p O)) h).
    pose proof (moved_speed_increases (speed V i) v' (held V i (p O)) (high O) h).
    destruct (IH (next V i (p O)) (later p) (later low) (later high) (moved_speed v (low O) h) (moved_speed v' (high O) h)) as [L U];
      try (rewrite So by lra; lra); [intros j; exact (B (S j)) |]. lra.
Qed.

Lemma drives_nonneg h share seen t n : 0 <= h -> 0 <= t -> forall v r l p, 0 <= v -> 0 <= drives (actuator h share seen) (v, r, l) p h n t.
Proof.
  intros Hh Ht. assert (forall v a x, 0 <= v -> 0 <= x -> 0 <= moved v (held_at v a) x) as M.
  { intros v a x Hv Hx. destruct (held_as_commanded v a x Hv Hx) as [-> _]. destruct (Rle_lt_dec 0 a) as [P | N].
    - assert (moved 0 0 x <= moved v a x) by (apply moved_increases; lra). unfold moved in H at 1.
      destruct (Rle_dec 0 (0 + 0 * x)) in H; lra.
    - rewrite moved_braking by assumption. pose proof (covered_at_least v (- a) 0 x). lra. }
  induction n as [| n IH]; intros v r l p Hv.
  - unfold drives, place, at_step, travels. simpl. specialize (M v (responds share r l (p O)) t Hv Ht). lra.
  - rewrite drives_later. unfold travels. simpl. specialize (M v (responds share r l (p O)) h Hv Hh).
    apply Rplus_le_le_0_compat; [exact M |]. apply IH. apply motion_of_the_ego; assumption.
Qed.

(** Lag, if the vehicle brakes harder than the command [c]: it drives at most as far as without lag,
  and at least as far as from the speed that
    the lag takes. *)
Theorem weaker_braking_with_lag_lies_between h share seen c t n : 0 < h -> 0 < share <= 1 -> c <= 0 -> 0 <= t <= h ->
  let lag := h * (1 - share) / share in forall v r, 0 <= v -> r <= c ->
  moved (Rmax 0 (v + lag * (r - c))) c (INR n * h + t) <= drives (actuator h share seen) (v, r,
    nil) (fun _ => c) h n t <= moved v c (INR n * h + t).
Proof.
  intros Hh Hs Hc Ht lag. assert (0 <= lag) as Hl.
  { unfold lag, Rdiv. apply Rmult_le_pos; [apply Rmult_le_pos; lra | left; apply Rinv_0_lt_compat; lra]. }
  assert (share * lag = h * (1 - share)) as El by (unfold lag; field; lra).
  assert (forall x, 0 <= x -> moved 0 c x = 0) as Rest.
  { intros x Hx. destruct (Req_dec c 0) as [-> | N]; [unfold moved; destruct (Rle_dec 0 (0 + 0 * x)); [field | exfalso; lra] |].
    assert (0 <= - c * x) by (apply Rmult_le_pos; lra). rewrite moved_braking by lra. rewrite covered_stopped by lra. field. lra. }
  induction n as [| n IH]; intros v r Hv Hr.
  all: set (k := (1 - share) * (c - r)); assert (0 <= k) as Hk by (apply Rmult_le_pos; lra).
  all: assert (responds share r nil c = c - k) as Er by (unfold responds, k; simpl; ring).
  all: assert (h * k <= lag * (c - r)) as Hz
    by (assert (h * k = share * (lag * (c - r))) as -> by (unfold k; rewrite <- (Rmult_assoc share lag), El; ring);
        assert (0 <= lag * (c - r)) by (apply Rmult_le_pos; lra); nra).
  all: set (z := v + lag * (r - c)); assert (z + h * k <= v) as Hzv by (unfold z; lra).
  all: assert (forall x, 0 <= x <= h -> moved (Rmax 0 z) c x <= moved v (c - k) x <= moved v c x) as Between.
  1, 3: intros x Hx; split; [| apply moved_increases; lra]; destruct (Rle_lt_dec z 0) as [Z | Z];
    [rewrite Rmax_left, Rest by lra; assert (moved 0 (c - k) x <= moved v (c - k) x) as M by (apply moved_increases; lra);
     destruct (Req_dec (c - k) 0) as [E | E];
     [rewrite E in *; unfold moved in M at 1; destruct (Rle_dec 0 (0 + 0 * x)) in M; lra |
      rewrite (moved_braking 0 (c - k)) in M by lra; pose proof (covered_at_least 0 (- (c - k)) 0 x); lra] |];
    rewrite Rmax_right by lra; destruct (Req_dec (c - k) 0) as [E | E];
    [assert (c = 0) as -> by lra; assert (k = 0) as -> by lra; apply moved_increases; lra |];
    rewrite (moved_braking v (c - k)) by lra; assert (k * x * x <= k * h * x) by (apply Rmult_le_compat_r; [lra | apply Rmult_le_compat_l;
      lra]);
    assert (forall s, 0 <= s <= x -> z * s + c * s * s / 2 <= covered v (- (c - k)) x) as Cov
      by (intros s Hs'; pose proof (covered_at_least v (- (c - k)) s x); assert (k * s * s <= k * h * s) by
            (apply Rmult_le_compat_r; [lra | apply Rmult_le_compat_l; lra]);
          assert ((z + h * k) * s <= v * s) by (apply Rmult_le_compat_r; lra); pose proof (squared_nonneg k s Hk); lra);
    (destruct (Req_dec c 0) as [C0 | C0];
     [specialize (Cov x ltac:(lra)); unfold moved; rewrite C0 in *; destruct (Rle_dec 0 (z + 0 * x)); [lra | exfalso; lra] |
      rewrite (moved_braking z c) by lra; destruct (covered_is z (- c) x) as [s [Hs' [_ ->]]]; try lra; specialize (Cov s Hs'); lra]).
  - unfold drives, place, at_step, travels. simpl. rewrite Er. destruct (held_as_commanded v (c - k) t) as [-> _]; try lra.
    specialize (Between t Ht). fold z. replace (0 * h + t) with t by ring. lra.
  - rewrite drives_later, S_INR. unfold travels. simpl. rewrite Er. destruct (held_as_commanded v (c - k) h) as [-> ->]; try lra.
    change (later (fun _ : nat => c)) with (fun _ : nat => c). fold z. specialize (Between h ltac:(lra)).
    pose proof (steps_nonneg h n t Hh (proj1 Ht)) as Hn. replace ((INR n + 1) * h + t) with (h + (INR n * h + t)) by ring.
    destruct (moved_on (Rmax 0 z) c h (INR n * h + t) (Rmax_l 0 z) (Rlt_le _ _ Hh) Hn) as [-> [_ Z1]].
    destruct (moved_on v c h (INR n * h + t) Hv (Rlt_le _ _ Hh) Hn) as [-> [_ V1]].
    assert (0 <= moved_speed v (c - k) h <= moved_speed v c h) as V2 by (apply moved_speed_increases; lra).
    destruct (IH (moved_speed v (c - k) h) (c - k)) as [L U]; [lra | lra |]. split.
    + set (D' := drives (actuator h share seen) (moved_speed v (c - k) h, c - k, nil) (fun _ => c) h n t) in *.
      assert (moved (moved_speed (Rmax 0 z) c h) c (INR n * h + t) <= D'); [| lra].
      assert (0 <= D') by (apply drives_nonneg; lra).
      assert (moved_speed (Rmax 0 z) c h = Rmax 0 (z + c * h) \/ moved_speed (Rmax 0 z) c h = 0) as [Sp | Sp].
      { unfold moved_speed. destruct (Rle_lt_dec z 0) as [Z | Z].
        - rewrite Rmax_left by exact Z. destruct (Rle_dec 0 (0 + c * h)); [right | right; reflexivity].
          assert (0 <= - c * h) by (apply Rmult_le_pos; lra). lra.
        - rewrite (Rmax_right 0 z) by lra. destruct (Rle_dec 0 (z + c * h)); [left; rewrite Rmax_right; lra | right; reflexivity]. }
      2: { rewrite Sp, Rest by exact Hn. exact H. }
      rewrite Sp. eapply Rle_trans; [| exact L]. apply moved_increases; [| lra | exact Hn]. split; [apply Rmax_l |]. apply Rle_max_compat_l.
      unfold moved_speed. assert (lag * (c - k - c) = - (lag * k)) by ring.
      assert (lag * k + h * k = lag * (c - r)) as Id.
      { unfold k. replace (lag * ((1 - share) * (c - r)) + h * ((1 - share) * (c - r))) with ((lag * (1 - share) + h * (1 - share)) * (c -
          r)) by ring.
        rewrite <- El. ring. }
      destruct (Rle_dec 0 (v + (c - k) * h)); unfold z; lra.
    + pose proof (moved_increases (moved_speed v (c - k) h) (moved_speed v c h) c c (INR n * h + t)). lra.
Qed.

(** Acceleration [a] for [N] steps, then [q]. *)
Definition hold (a : R) (N : nat) (q : nat -> R) : nat -> R := fun j => if (j <? N)%nat then a else q (j - N)%nat.

Lemma held_for_steps h seen a q t N : 0 <= h -> 0 <= t -> forall v, 0 <= v ->
  (forall n, (n < N)%nat -> drives (direct h seen) v (hold a N q) h n t = moved v a (INR n * h + t)) /\
  (forall n, drives (direct h seen) v (hold a N q) h (N + n) t =
    moved v a (INR N * h) + drives (direct h seen) (moved_speed v a (INR N * h)) q h n t).
Proof.
  intros Hh Ht. assert (forall v, 0 <= v -> moved v a 0 = 0 /\ moved_speed v a 0 = v) as Zero.
  { intros v Hv. unfold moved, moved_speed. destruct (Rle_dec 0 (v + a * 0)); [split; [field | ring] | exfalso; lra]. }
  induction N as [| N IH]; intros v Hv.
  - split; [intros n Hn; inversion Hn |]. intros n. simpl. rewrite Rmult_0_l. destruct (Zero v Hv) as [-> ->]. rewrite Rplus_0_l.
    apply drives_same. intros j. unfold hold. simpl. f_equal. apply Nat.sub_0_r.
  - assert (travels (direct h seen) v (hold a (S N) q O) h = moved v a h) as T1 by (apply (held_as_commanded v a h Hv Hh)).
    assert (next (direct h seen) v (hold a (S N) q O) = moved_speed v a h) as T2 by (apply (held_as_commanded v a h Hv Hh)).
    destruct (moved_on v a h 0 Hv Hh (Rle_refl 0)) as [_ [_ Hv1]]. destruct (IH (moved_speed v a h) Hv1) as [IH1 IH2].
    assert (forall j, later (hold a (S N) q) j = hold a N q j) as L by (intros j; reflexivity). split.
    + intros [| n] Hn.
      * unfold drives, place, at_step. change (travels (direct h seen) v (hold a (S N) q O) t) with (moved v (held_at v a) t).
        destruct (held_as_commanded v a t Hv Ht) as [-> _]. simpl. replace (0 * h + t) with t by ring. ring.
      * rewrite drives_later, T1, T2, (drives_same _ _ _ _ n _ _ L), IH1, S_INR by (apply le_S_n; exact Hn).
        replace ((INR n + 1) * h + t) with (h + (INR n * h + t)) by ring. symmetry. apply moved_on; try assumption.
        pose proof (pos_INR n). pose proof (Rmult_le_pos _ _ H Hh). lra.
    + intros n. change (S N + n)%nat with (S (N + n)). rewrite drives_later, T1, T2, (drives_same _ _ _ _ (N + n)%nat _ _ L), IH2, S_INR.
      replace ((INR N + 1) * h) with (h + INR N * h) by ring. pose proof (pos_INR N) as HN. pose proof (Rmult_le_pos _ _ HN Hh) as HN'.
      destruct (moved_on v a h (INR N * h) Hv Hh HN') as [-> [-> _]]. ring.
Qed.

(** A and B for a held acceleration, and then for the rest. *)
Theorem held_then_the_rest_ahead W seen v g w a N q : valid W -> 0 <= v -> 0 <= w ->
  let V := direct (dt W) seen in let T := INR N * dt W in
  (forall t, 0 <= t <= T -> margin_ahead W <= g + covered w (limit W) t - moved v a t) ->
  stays_behind_the_leader (V := V) W (moved_speed v a T) (g + covered w (limit W) T - moved v a T) (braked w (limit W) T) q ->
  stays_behind_the_leader (V := V) W v g w (hold a N q).
Proof.
  intros [Hh [Hc _]] Hv Hw V T Piece Rest n t Ht. destruct (held_for_steps (dt W) seen a q t N (Rlt_le _ _ Hh) (proj1 Ht) v Hv) as [E1 E2].
  pose proof (Rmult_le_pos _ _ (pos_INR N) (Rlt_le _ _ Hh)) as HT. fold T in HT. destruct (Nat.lt_ge_cases n N) as [L | L].
  - unfold V. rewrite E1 by exact L. apply Piece. split; [apply steps_nonneg; lra |]. apply le_INR in L. rewrite S_INR in L.
    assert ((INR n + 1) * dt W <= INR N * dt W) by (apply Rmult_le_compat_r; lra). unfold T. lra.
  - replace n with (N + (n - N))%nat in * by (rewrite Nat.add_comm; apply Nat.sub_add; exact L). set (k := (n - N)%nat) in *. unfold V.
    rewrite E2, plus_INR.
    specialize (Rest k t Ht). fold V. fold T. replace ((INR N + INR k) * dt W + t) with (T + (INR k * dt W + t)) by (unfold T; ring).
    rewrite covered_on by (try assumption; apply steps_nonneg; lra). lra.
Qed.

Theorem held_then_the_rest_behind W seen v r u d a N q : valid W -> 0 <= v -> 0 <= u -> 0 <= d ->
  let V := direct (dt W) seen in let T := INR N * dt W in
  (forall t, 0 <= t <= T -> margin_behind W <= r + moved v a t - reached u (react W) d (bf W) t) ->
  stays_ahead_of_the_follower (V := V) W (moved_speed v a T) (r + moved v a T - reached u (react W) d (bf W) T)
    (speed_reached u (react W) d (bf W) T) (Rmax 0 (d - T)) q ->
  stays_ahead_of_the_follower (V := V) W v r u d (hold a N q).
Proof.
  intros [Hh [Hc [_ [_ [Hb [_ [_ Ha]]]]]]] Hv Hu Hd V T Piece Rest n t Ht.
  destruct (held_for_steps (dt W) seen a q t N (Rlt_le _ _ Hh) (proj1 Ht) v Hv) as [E1 E2].
  pose proof (Rmult_le_pos _ _ (pos_INR N) (Rlt_le _ _ Hh)) as HT. fold T in HT. destruct (Nat.lt_ge_cases n N) as [L | L].
  - unfold V. rewrite E1 by exact L. apply Piece. split; [apply steps_nonneg; lra |]. apply le_INR in L. rewrite S_INR in L.
    assert ((INR n + 1) * dt W <= INR N * dt W) by (apply Rmult_le_compat_r; lra). unfold T. lra.
  - replace n with (N + (n - N))%nat in * by (rewrite Nat.add_comm; apply Nat.sub_add; exact L). set (k := (n - N)%nat) in *. unfold V.
    rewrite E2, plus_INR.
    specialize (Rest k t Ht). fold V. fold T. replace ((INR N + INR k) * dt W + t) with (T + (INR k * dt W + t)) by (unfold T; ring).
    rewrite reached_on by (try assumption; apply steps_nonneg; lra). lra.
Qed.

(** More steps of an acceleration before full braking keep B: so the filter may compute their number again when the follower fires. *)
Theorem more_steps_are_as_good_behind W seen v r u d a b N N' : valid W -> 0 <= v -> - b <= a -> (N <= N')%nat ->
  stays_ahead_of_the_follower (V := direct (dt W) seen) W v r u d (hold a N (fun _ => - b)) ->
  stays_ahead_of_the_follower (V := direct (dt W) seen) W v r u d (hold a N' (fun _ => - b)).
Proof.
  intros [Hh _] Hv Ha HN. apply farther_is_as_good_behind. intros n t Ht. apply larger_commands_drive_farther; [lra | lra | lra |].
  intros j. unfold hold. destruct (Nat.ltb_spec j N) as [L | L]; destruct (Nat.ltb_spec j N') as [L' | L']; try lra.
  exfalso. apply (Nat.lt_irrefl j). eapply Nat.lt_le_trans; [exact L |]. eapply Nat.le_trans; [exact HN | exact L'].
Qed.

(** A for full braking: the demanded gap. *)
Theorem full_braking_stays_behind W seen b v g w : valid W -> 0 < b -> 0 <= v -> 0 <= w -> D b (limit W) v w + margin_ahead W <= g ->
  stays_behind_the_leader (V := direct (dt W) seen) W v g w (fun _ => - b).
Proof.
  intros [Hh [Hc _]] Hb Hv Hw HD n t Ht. destruct (held_for_steps (dt W) seen (- b) (fun _ => - b) t (S n) (Rlt_le _ _ Hh) (proj1 Ht) v
    Hv) as [E _].
  assert (drives (direct (dt W) seen) v (fun _ => - b) (dt W) n t = moved v (- b) (INR n * dt W + t)) as ->.
  { rewrite <- (E n (Nat.lt_succ_diag_r n)). apply drives_same. intros j. unfold hold. destruct (j <? S n)%nat; reflexivity. }
  rewrite moved_braking by lra. replace (- - b) with b by ring.
  pose proof (demanded_is_enough b (limit W) v w (INR n * dt W + t) Hb Hc Hv Hw (steps_nonneg _ n t Hh (proj1 Ht))) as E0.
  unfold closing in E0. lra.
Qed.

(** A for an acceleration that is not negative, ahead of which the leader brakes fully: its ends suffice. *)
Theorem acceleration_is_worst_at_its_ends c g w v a m T t : 0 < c -> 0 <= w -> 0 <= v -> 0 <= a -> 0 <= t <= T ->
  m <= g -> m <= g + covered w c T - moved v a T -> m <= g + covered w c t - moved v a t.
Proof.
  intros Hc Hw Hv Ha Ht G E. destruct (Req_dec T 0) as [Z | Z]; [subst; assert (t = 0) as -> by lra; exact E |].
  set (y := t / T). assert (t = y * T) as Ey by (unfold y; field; lra).
  assert (0 <= y <= 1) as Hy.
  { unfold y, Rdiv. assert (0 < / T) by (apply Rinv_0_lt_compat; lra). split; [apply Rmult_le_pos; lra |].
    apply (Rmult_le_reg_r T); [lra |]. rewrite Rmult_assoc, Rinv_l; lra. }
  assert (moved v a t <= y * moved v a T) as M.
  { pose proof (Rmult_le_pos a t). pose proof (Rmult_le_pos a T). unfold moved. destruct (Rle_dec 0 (v + a * t)); [| exfalso; lra].
    destruct (Rle_dec 0 (v + a * T)); [| exfalso; lra]. rewrite Ey. assert (0 <= y * (1 - y)) by (apply Rmult_le_pos; lra).
    pose proof (squared_nonneg a T Ha). assert (0 <= y * (1 - y) * (a * T * T)) by (apply Rmult_le_pos; lra). lra. }
  assert (y * covered w c T <= covered w c t) as C.
  { destruct (covered_is w c T) as [s [Hs [_ ->]]]; try lra.
    assert (0 <= y * s <= t) as Hys by (split; [apply Rmult_le_pos; lra | rewrite Ey; apply Rmult_le_compat_l; lra]).
    pose proof (covered_at_least w c (y * s) t Hc Hys). assert (0 <= y * (1 - y)) by (apply Rmult_le_pos; lra).
    pose proof (squared_nonneg c s (Rlt_le _ _ Hc)). assert (0 <= y * (1 - y) * (c * s * s)) by (apply Rmult_le_pos; lra). lra. }
  apply (Rmult_le_compat_l y) in E; [| lra]. assert ((1 - y) * m <= (1 - y) * g) by (apply Rmult_le_compat_l; lra). lra.
Qed.

(** * A slower follower is not safer *)

(** An ego vehicle at 20 m/s that brakes fully (8 m/s²) after 10 s. *)
Definition example_position (t : R) : R := if Rle_dec t 10 then 20 * t else 200 + covered 20 8 (t - 10).
Definition example_speed (t : R) : R := if Rle_dec t 10 then 20 else braked 20 8 (t - 10).

(** Two followers begin at 30 m/s, 51 m behind, and fire at a time to collision of 1.4 s.
One that coasts does so after 3.7 s; 0.11 s later it
    brakes at 6 m/s², and never comes near. One that slows by 1 m/s² is behind it all the time and does not fire within 10 s.
    It then collides
    although it brakes at 6 m/s² at the same instant as the ego vehicle. *)
Theorem a_slower_follower_is_not_safer :
  (forall t, 0 <= t <= 37 / 10 -> 14 / 10 * (30 - example_speed t) <= 51 + example_position t - 30 * t) /\
  51 + example_position (371 / 100) - 30 * (371 / 100) < 14 / 10 * (30 - example_speed (371 / 100)) /\
  (forall t, 0 <= t -> 4 < 51 + example_position t - reached 30 0 (381 / 100) 6 t) /\
  (forall t, 0 <= t -> covered 30 1 t <= 30 * t) /\
  (forall t, 0 <= t <= 10 -> 14 / 10 * (braked 30 1 t - example_speed t) < 51 + example_position t - covered 30 1 t) /\
  exists t, 10 < t /\ 51 + example_position t - (covered 30 1 10 + covered (braked 30 1 10) 6 (t - 10)) < -5.
Proof.
  assert (forall t, t <= 10 -> example_position t = 20 * t /\ example_speed t = 20) as Cruise.
  { intros t Ht. unfold example_position, example_speed. destruct (Rle_dec t 10); [auto | lra]. }
  split; [| split; [| split; [| split; [| split]]]].
  - intros t Ht. destruct (Cruise t) as [-> ->]; lra.
  - destruct (Cruise (371 / 100)) as [-> ->]; lra.
  - intros t Ht. unfold reached. destruct (Rle_lt_dec t (381 / 100)) as [E | E].
    + rewrite Rmin_left by lra. replace (t - t) with 0 by ring. rewrite covered_nothing by lra. destruct (Cruise t) as [-> _]; lra.
    + rewrite Rmin_right by lra. replace (30 + 0 * (381 / 100)) with 30 by ring. destruct (Rle_lt_dec t 10) as [F | F].
      * destruct (Cruise t F) as [-> _]. destruct (covered_is 30 6 (t - 381 / 100)) as [s [Hs [_ ->]]]; try lra.
        pose proof (Rle_0_sqr (s - 5 / 3)) as Q. unfold Rsqr in Q. lra.
      * pose proof (covered_at_most 30 6 (t - 381 / 100)). pose proof (covered_at_least 20 8 0 (t - 10)).
        unfold example_position. destruct (Rle_dec t 10); lra.
  - intros t Ht. destruct (covered_is 30 1 t) as [s [Hs [_ ->]]]; try lra. pose proof (squared_nonneg 1 s). lra.
  - intros t Ht. destruct (Cruise t) as [-> ->]; [lra |]. rewrite covered_moving by lra. rewrite braked_is, Rmax_right by lra.
    pose proof (Rle_0_sqr (t - 43 / 5)) as Q. unfold Rsqr in Q. lra.
  - exists (25 / 2). split; [lra |]. unfold example_position. destruct (Rle_dec (25 / 2) 10); [lra |].
    rewrite braked_is, Rmax_right by lra. rewrite !covered_moving by lra. lra.
Qed.

(** * The statements are not empty *)

(** Each state that is covered has a next step: the leader holds its speed, and the follower brakes at once, or holds its speed. *)
Theorem each_state_has_a_step V W (s : state V) a : valid W -> 0 <= lead s -> 0 <= rear s -> 0 <= due W s ->
  0 < speed V (ego s) \/ creep W <= rear s -> exists y f z q s', step W s a y f z q s'.
Proof.
  intros [Hh [Hc [_ [_ [Hb [Hf [Hri Hre]]]]]]] Hw Hu Hd Cr.
  assert (forall v t, derivable_pt_lim (fun s => v * s) t v) as Lin.
  { intros v t. pose proof (derivable_pt_lim_scal (fun s => s) v t 1 (derivable_pt_lim_id t)) as H. rewrite Rmult_1_r in H. exact H. }
  assert (within_limit (limit W) (lead s) (fun t => lead s * t) (fun _ => lead s)) as Le.
  { split; [ring |]. split; [reflexivity |]. split; [intros t Ht; apply Lin |]. split; [intros; exact Hw |].
    intros x t Hx. assert (0 <= limit W * (t - x)) by (apply Rmult_le_pos; lra). lra. }
  destruct (alarmed W s a) eqn:Al.
  - assert (forall x t, x <= t -> braked (rear s) (bf W) t <= braked (rear s) (bf W) x) as Falls by (intros; apply braked_falls;
      assumption).
    exists (fun t => lead s * t), (fun _ => lead s), (covered (rear s) (bf W)), (braked (rear s) (bf W)).
    exists (State (next V (ego s) a) (ahead s + lead s * dt W - own s a (dt W)) (lead s)
      (behind s + own s a (dt W) - covered (rear s) (bf W) (dt W)) (braked (rear s) (bf W) (dt W)) (Braking (Rmax 0 (due W s - dt W)))).
    split; [exact Le |]. split; [| reflexivity]. unfold follower. rewrite Al.
    split; [split; [apply covered_nothing; exact Hu |]; split; intros; [apply covered_derivable; lra | apply braked_nonneg] |].
    split; [rewrite braked_is, Rmult_0_r, Rminus_0_r; apply Rmax_right; exact Hu |]. split; [| split; [| reflexivity]].
    + intros x t Hx Ht. specialize (Falls x t). assert (0 <= react W * (t - x)) by (apply Rmult_le_pos; lra). lra.
    + intros x t Hx Ht. replace t with (x + (t - x)) at 1 by ring. rewrite <- braked_on by lra. rewrite braked_is. lra.
  - exists (fun t => lead s * t), (fun _ => lead s), (fun t => rear s * t), (fun _ => rear s).
    exists (State (next V (ego s) a) (ahead s + lead s * dt W - own s a (dt W)) (lead s)
      (behind s + own s a (dt W) - rear s * dt W) (rear s) Waiting).
    split; [exact Le |]. split; [| reflexivity]. unfold follower. rewrite Al.
    split; [split; [apply Rmult_0_r |]; split; intros; [apply Lin | exact Hu] |]. split; [reflexivity |].
    split; [| split; [reflexivity |]]; [| intros _; split; [| exact Cr]]; intros x t Hx Ht.
    + assert (0 <= rise W * (t - x)) by (apply Rmult_le_pos; lra). lra.
    + assert (0 <= fall W * (t - x)) by (apply Rmult_le_pos; lra). lra.
Qed.

(** Three vehicles at 20 m/s, 10 m and 21 m apart, are in S if all can brake at 8 m/s² and the follower has fired half a second ago. *)
Definition example_world : world := World (1 / 100) 8 1 1 Fires (14 / 10) (1 / 2) 8 (3 / 10) (3 / 10) 0 (1 / 2).

Theorem the_set_has_an_example : in_S example_world (State (V := direct (1 / 100) 1) 20 10 20 21 20 (Braking (1 / 2))).
Proof.
  assert (valid example_world) as Val by (unfold valid, example_world; simpl; repeat split; lra). exists (Go (fun _ => - 8)).
  apply both_conditions_suffice; [exact Val |].
  exists (fun _ => - 8). split; [reflexivity |]. split; [unfold due; cbn [stage]; lra |]. split; [reflexivity |].
  cbn [ego ahead lead behind rear].
  pose proof (full_braking_stays_behind example_world 1 8 20 10 20 Val) as A. split.
  - apply A; try lra. unfold D. cbn [limit margin_ahead example_world]. destruct (Rle_dec 8 8); [| lra]. rewrite Rmax_right; lra.
  - intros n t Ht. cbn [dt example_world] in Ht. pose proof (steps_nonneg (1 / 100) n t ltac:(lra) (proj1 Ht)) as Hn. unfold due.
    cbn [stage]. cbn [dt margin_behind react bf example_world].
    set (x := INR n * (1 / 100) + t) in *.
    assert (covered 20 8 x <= drives (direct (1 / 100) 1) 20 (fun _ => - 8) (1 / 100) n t) as Own.
    { destruct (held_for_steps (1 / 100) 1 (- 8) (fun _ => - 8) t (S n) ltac:(lra) (proj1 Ht) 20 ltac:(lra)) as [E _].
      rewrite (drives_same (direct (1 / 100) 1) 20 (1 / 100) t n (fun _ => - 8) (hold (- 8) (S n) (fun _ => - 8))).
      - rewrite (E n (Nat.lt_succ_diag_r n)). fold x. rewrite moved_braking by lra. replace (- - 8) with 8 by ring. lra.
      - intros j. unfold hold. destruct (j <? S n)%nat; reflexivity. }
    assert (reached 20 0 (1 / 2) 8 x <= 10 + covered 20 8 x); [| lra].
    unfold reached. replace (20 + 0 * Rmin x (1 / 2)) with 20 by ring. destruct (Rle_lt_dec x (1 / 2)) as [E | E].
    + rewrite Rmin_left by exact E. replace (x - x) with 0 by ring. rewrite (covered_nothing 20) by lra.
      pose proof (covered_at_least 20 8 0 x). lra.
    + rewrite Rmin_right by lra. pose proof (covered_grows 20 8 (x - 1 / 2) x). lra.
Qed.
