(** The check is sound: where it succeeds, no estimate costs less than L. *)

From Coq Require Import Reals ZArith QArith Qreals List Bool FMapPositive Lra Lia.
From Certpgo Require Import Statement Definite Check.
Import ListNotations.
Local Open Scope R_scope.

(** * Sums *)

Definition total {A} (f : A -> R) (l : list A) : R := fold_right Rplus 0 (map f l).

Lemma total_le {A} (f g : A -> R) l : (forall x, In x l -> f x <= g x) -> total f l <= total g l.
Proof.
  unfold total; induction l as [|x l IH]; intros le; simpl; [lra|].
  apply Rplus_le_compat; [apply le; left; auto | apply IH; intros; apply le; right; auto].
Qed.

Lemma total_ext {A} (f g : A -> R) l : (forall x, In x l -> f x = g x) -> total f l = total g l.
Proof. intros eq; apply Rle_antisym; apply total_le; intros x H; rewrite (eq x H); lra. Qed.

Lemma total_plus {A} (f g : A -> R) l : total (fun x => f x + g x) l = total f l + total g l.
Proof. unfold total; induction l as [|x l IH]; simpl; [|rewrite IH]; lra. Qed.

Lemma total_times {A} c (f : A -> R) l : total (fun x => c * f x) l = c * total f l.
Proof. unfold total; induction l as [|x l IH]; simpl; [|rewrite IH]; ring. Qed.

Lemma total_exchange {A B} (f : A -> B -> R) l m :
  total (fun x => total (f x) m) l = total (fun y => total (fun x => f x y) l) m.
Proof.
  induction l as [|x l IH]; unfold total in *; simpl.
  - induction m as [|y m IHm]; simpl; [|rewrite <- IHm]; lra.
  - rewrite IH; fold (total (f x) m).
    fold (total (fun y => fold_right Rplus 0 (map (fun x => f x y) l)) m).
    rewrite <- total_plus; reflexivity.
Qed.

Lemma total_IZR {A} (f : A -> Z) l :
  total (fun x => IZR (f x)) l = IZR (fold_right Z.add 0%Z (map f l)).
Proof. unfold total; induction l as [|x l IH]; simpl; [|rewrite plus_IZR, IH]; reflexivity. Qed.

Lemma sum_total d f : sum d f = total f (seq 0 d).
Proof. reflexivity. Qed.

(** * Numbers *)

Lemma pow_positive n : (0 <= n)%Z -> 0 < IZR (2 ^ n).
Proof. intros; apply IZR_lt, Z.pow_pos_nonneg; lia. Qed.

Lemma quotient_bounds a b : (0 < b)%Z -> IZR (a / b) <= IZR a / IZR b < IZR (a / b) + 1.
Proof.
  intros b_positive; assert (0 < IZR b) by (apply IZR_lt; lia).
  pose proof (Z.mul_div_le a b b_positive) as low; apply IZR_le in low.
  pose proof (Z.mul_succ_div_gt a b b_positive) as high; apply IZR_lt in high.
  rewrite mult_IZR in low, high; rewrite succ_IZR in high.
  split; [apply Rmult_le_reg_r with (IZR b) | apply Rmult_lt_reg_r with (IZR b)]; auto;
    unfold Rdiv; rewrite Rmult_assoc, Rinv_l; lra.
Qed.

Lemma shiftr_bounds a n : (0 <= n)%Z ->
  IZR (Z.shiftr a n) <= IZR a / IZR (2 ^ n) < IZR (Z.shiftr a n) + 1.
Proof.
  intros; rewrite Z.shiftr_div_pow2 by auto; apply quotient_bounds, Z.pow_pos_nonneg; lia.
Qed.

Lemma Q2R_quotient q : Q2R q * IZR (Zpos (Qden q)) = IZR (Qnum q).
Proof. unfold Q2R; field; apply not_0_IZR; discriminate. Qed.

Lemma floor_bound n q : (0 <= n)%Z -> IZR (floor n q) <= Q2R q * IZR (2 ^ n).
Proof.
  intros; unfold floor; rewrite Z.shiftl_mul_pow2 by auto.
  pose proof (quotient_bounds (Qnum q * 2 ^ n) (Zpos (Qden q)) eq_refl) as [bound _].
  rewrite mult_IZR in bound; unfold Q2R, Rdiv in *; lra.
Qed.

Lemma floor_whole n q : (0 <= n)%Z -> whole n q = true -> IZR (floor n q) = Q2R q * IZR (2 ^ n).
Proof.
  unfold whole; intros n_nonneg exact; apply Z.eqb_eq in exact; apply (f_equal IZR) in exact.
  rewrite Z.shiftl_mul_pow2, !mult_IZR in exact by auto.
  apply Rmult_eq_reg_r with (IZR (Zpos (Qden q))); [|apply not_0_IZR; discriminate].
  rewrite exact, <- Q2R_quotient; ring.
Qed.

Lemma number_floor n l k : (0 <= n)%Z -> forallb (whole n) l = true ->
  IZR (nth k (map (floor n) l) 0%Z) = number l k * IZR (2 ^ n).
Proof.
  intros n_nonneg exact; unfold number.
  revert k; induction l as [|q l IH]; intros k; simpl in *.
  - destruct k; unfold Q2R; simpl; lra.
  - apply andb_prop in exact; destruct exact, k; [apply floor_whole | apply IH]; auto.
Qed.

Lemma zero_Q2R q : zero q = true -> Q2R q = 0.
Proof. unfold zero, Q2R; intros H; apply Z.eqb_eq in H; rewrite H; lra. Qed.

(** * Values of forms *)

Section Forms.
Variable y : positive -> R.

Lemma values_app A B : values y (A ++ B) = values y A + values y B.
Proof. unfold values; induction A; simpl; [|rewrite IHA]; lra. Qed.

Lemma values_flat_map {A} (f : A -> list form) c l :
  (forall x, In x l -> values y (f x) <= c x) -> values y (flat_map f l) <= total c l.
Proof.
  unfold total; induction l as [|x l IH]; intros le; simpl; [unfold values; simpl; lra|].
  rewrite values_app; apply Rplus_le_compat; [apply le; left; auto|].
  apply IH; intros; apply le; right; auto.
Qed.

Lemma values_map {A} (f : A -> form) c l :
  (forall x, In x l -> value y (f x) <= c x) -> values y (map f l) <= total c l.
Proof.
  unfold total, values; induction l as [|x l IH]; intros le; simpl; [lra|].
  apply Rplus_le_compat; [apply le; left; auto | apply IH; intros; apply le; right; auto].
Qed.

Lemma diagonal_value r z : value y (diagonal r z) = IZR z * y r ^ 2.
Proof. simpl; ring. Qed.

Lemma diagonal_bound r z c : IZR z <= c -> value y (diagonal r z) <= c * y r ^ 2.
Proof. rewrite diagonal_value; intros; apply Rmult_le_compat_r; auto; apply pow2_ge_0. Qed.

Lemma product_bound r s z c :
  IZR z <= c <= IZR z + 1 -> value y (product r s z) <= 2 * c * y r * y s.
Proof.
  intros near; assert (value y (product r s z) = 2 * IZR z * y r * y s - y r ^ 2 - y s ^ 2) as ->
    by (unfold product; destruct (Pos.ltb r s); simpl; ring).
  pose proof (pow2_ge_0 (y r - y s)); pose proof (pow2_ge_0 (y r + y s)); nra.
Qed.

Lemma square_bound bits w u : (0 <= bits)%Z ->
  values y (square bits w u) <= IZR w / IZR (2 ^ bits) * linear_value y u ^ 2.
Proof.
  intros bits_nonneg; set (W := IZR w / IZR (2 ^ bits)).
  assert (times : forall z v, IZR (z * (v * w)) / IZR (2 ^ bits) = IZR z * IZR v * W)
    by (intros; rewrite !mult_IZR; unfold W, Rdiv; ring).
  induction u as [|[r x] u IH]; cbn [square linear_value]; [unfold values; simpl; lra|].
  change (values y (?A :: ?B)) with (value y A + values y B); rewrite values_app.
  assert (square_term : value y (diagonal r (Z.shiftr (x * (x * w)) bits))
                        <= IZR x * IZR x * W * y r ^ 2).
  { apply diagonal_bound; rewrite <- times; apply shiftr_bounds; auto. }
  assert (products : values y (map (fun '(s, z) => product r s (Z.shiftr (z * (x * w)) bits)) u)
                     <= 2 * IZR x * W * y r * linear_value y u).
  { clear - bits_nonneg times; induction u as [|[s z] u IH]; simpl.
    - unfold values; simpl; lra.
    - change (values y (?A :: ?B)) with (value y A + values y B).
      pose proof (product_bound r s (Z.shiftr (z * (x * w)) bits) (IZR z * IZR x * W)) as bound.
      rewrite <- times in bound; pose proof (shiftr_bounds (z * (x * w)) bits bits_nonneg).
      rewrite times in *; lra. }
  lra.
Qed.
End Forms.

Lemma in_upper d a b : In (a, b) (upper d) -> (a < d /\ b < d)%nat.
Proof.
  unfold upper, dimensions; rewrite in_flat_map; intros [c [in_c in_ab]].
  apply in_map_iff in in_ab; destruct in_ab as [e [same in_e]]; inversion same; subst.
  apply in_seq in in_c, in_e; lia.
Qed.

(** * Variables: a row of all rotations, and the same coordinate of all positions *)

Section Row.
Variable d : nat.
Variable P : proof.
Variable of_node : PositiveMap.t positive.
Variable at_place : PositiveMap.t Z.
Variable rho : Z -> nat -> R.
Variable pos : Z -> R.

Let node := node at_place.
Let place := place of_node.
Let placed := placed of_node at_place.

Definition variable (v : positive) : R :=
  match v with
  | (p~0~0)%positive => pos (node p)
  | (p~0~1)%positive => rho (node p) 0
  | (p~1~0)%positive => rho (node p) 1
  | (p~1~1)%positive => rho (node p) 2
  | _ => 0
  end.

Lemma variable_position k : placed k = true -> variable (position (place k)) = pos k.
Proof. intros H; apply Z.eqb_eq in H; simpl; unfold node, place; rewrite H; reflexivity. Qed.

Lemma variable_rotated k a : (a < 3)%nat ->
  placed k = true -> variable (rotated (place k) a) = rho k a.
Proof.
  intros small H; apply Z.eqb_eq in H; unfold node, place in *.
  destruct a as [|[|[|a]]]; simpl; try lia; unfold node; rewrite H; reflexivity.
Qed.

Hypothesis dimension : d = 2%nat \/ d = 3%nat.
Hypothesis unit_nonneg : (0 <= unit P)%Z.
Hypothesis metre_nonneg : (0 <= metre P)%Z.
Hypothesis turn_nonneg : (0 <= turn P)%Z.
Hypothesis rotation_guard_nonneg : (0 <= rotation_guard P)%Z.
Hypothesis translation_guard_nonneg : (0 <= translation_guard P)%Z.
Hypothesis tau_bits_nonneg : (2 * metre P <= unit P + translation_guard P)%Z.

Let scale := IZR (2 ^ unit P).

Lemma rotation_bound a b kappa x y z w :
  placed a = true -> placed b = true -> (0 < norm [x; y; z; w])%Z ->
  (d = 2%nat -> x = 0%Z /\ y = 0%Z) ->
  values variable (rotation_forms d P (place a) (place b) kappa [x; y; z; w])
  <= scale * (Q2R kappa * sum d (fun c =>
       (rho b c - sum d (fun e => rho a e *
          (IZR (entry (matrix_of [x; y; z; w]) e c) / IZR (norm [x; y; z; w])))) ^ 2)).
Proof.
  intros placed_a placed_b; set (D := norm [x; y; z; w]); set (N := matrix_of [x; y; z; w]).
  intros D_positive plane; unfold rotation_forms; fold D N.
  set (k := (floor (unit P + rotation_guard P) kappa / D)%Z).
  set (G := IZR (2 ^ rotation_guard P)).
  assert (0 < G) by (apply pow_positive; auto).
  assert (0 < IZR D) as D_real by (apply IZR_lt; auto).
  assert (lighter : IZR k / G * IZR D <= scale * Q2R kappa).
  { pose proof (quotient_bounds (floor (unit P + rotation_guard P) kappa) D D_positive) as [low _].
    pose proof (floor_bound (unit P + rotation_guard P) kappa ltac:(lia)) as high; fold k in low.
    rewrite Z.pow_add_r, mult_IZR in high by auto; fold scale G in high.
    apply Rmult_le_reg_r with G; auto.
    replace (IZR k / G * IZR D * G) with (IZR k * IZR D) by (field; lra).
    apply Rmult_le_compat_r with (r := IZR D) in low; [|lra].
    unfold Rdiv in low; rewrite Rmult_assoc, Rinv_l in low; lra. }
  rewrite values_app.
  match goal with |- ?A + ?B <= _ =>
    assert (A <= sum d (fun e => IZR k / G * IZR D * (rho a e ^ 2 + rho b e ^ 2))) as squares;
    [|assert (B <= sum d (fun e => sum d (fun c =>
        2 * (- IZR k / G * IZR (entry N e c)) * rho a e * rho b c))) as products]
  end.
  - apply values_flat_map; intros e in_e; apply in_seq in in_e.
    change (values variable [?A; ?B]) with (value variable A + (value variable B + 0)).
    rewrite Rplus_0_r, Rmult_plus_distr_l.
    assert (IZR (Z.shiftr (k * D) (rotation_guard P)) <= IZR k / G * IZR D).
    { pose proof (shiftr_bounds (k * D) (rotation_guard P) rotation_guard_nonneg) as [low _].
      rewrite mult_IZR in low; fold G in low; unfold Rdiv in *; lra. }
    rewrite <- (variable_rotated a e), <- (variable_rotated b e) by (auto; lia).
    apply Rplus_le_compat; apply diagonal_bound; auto.
  - apply values_flat_map; intros e in_e; apply in_seq in in_e.
    apply values_map; intros c in_c; apply in_seq in in_c.
    rewrite <- (variable_rotated a e), <- (variable_rotated b c) by (auto; lia).
    apply product_bound.
    pose proof (shiftr_bounds (- k * entry N e c) (rotation_guard P) rotation_guard_nonneg)
      as [low high].
    rewrite mult_IZR, opp_IZR in low, high; fold G in low, high; unfold Rdiv in *; lra.
  - eapply Rle_trans; [apply Rplus_le_compat; [apply squares | apply products]|].
    set (S := sum d (fun c => (rho b c - sum d (fun e => rho a e * _)) ^ 2)).
    assert (0 <= S) as S_nonneg by
      (unfold S, sum; destruct dimension as [-> | ->]; simpl;
       repeat apply Rplus_le_le_0_compat; try lra; try (rewrite Rmult_1_r; apply Rle_0_sqr)).
    apply Rle_trans with (IZR k / G * IZR D * S).
    2: { rewrite <- Rmult_assoc; apply Rmult_le_compat_r; auto. }
    right; unfold S; clear S S_nonneg squares products lighter.
    assert (IZR D <> 0) as D_nonzero by lra.
    unfold entry, N, matrix_of, sum; clear D_positive D_real N.
    unfold D, norm in *; clear D.
    cbn -[Z.mul Z.add Z.sub Z.opp IZR] in D_nonzero |- *.
    destruct dimension as [-> | ->]; [destruct (plane eq_refl) as [-> ->]|]; clear plane;
      cbn -[Z.mul Z.add Z.sub Z.opp IZR pow];
      repeat rewrite ?plus_IZR, ?minus_IZR, ?opp_IZR, ?mult_IZR in *; field; lra.
Qed.

Lemma translation_bound a b tau t :
  placed a = true -> placed b = true -> forallb (whole (metre P)) t = true ->
  values variable (translation_forms d P (place a) (place b) tau (map (floor (metre P)) t))
  <= scale * (Q2R tau * (IZR (step P) / IZR (2 ^ metre P) * (pos b - pos a)
                         - sum d (fun c => rho a c * number t c)) ^ 2).
Proof.
  intros placed_a placed_b exact; unfold translation_forms.
  eapply Rle_trans; [apply square_bound; auto|].
  set (G := IZR (2 ^ translation_guard P)); set (M := IZR (2 ^ metre P)).
  assert (0 < G) by (apply pow_positive; auto); assert (0 < M) by (apply pow_positive; auto).
  assert (lighter : forall S, 0 <= S ->
    IZR (floor (unit P + translation_guard P - 2 * metre P) tau) / G * (M ^ 2 * S)
    <= scale * (Q2R tau * S)).
  { intros S S_nonneg.
    pose proof (floor_bound (unit P + translation_guard P - 2 * metre P) tau ltac:(lia)) as high.
    assert (scale * G = IZR (2 ^ (unit P + translation_guard P - 2 * metre P)) * M ^ 2) as powers.
    { unfold scale, G, M; simpl pow; rewrite Rmult_1_r, <- !mult_IZR, <- !Z.pow_add_r by lia.
      do 2 f_equal; lia. }
    apply Rmult_le_reg_r with G; auto.
    replace (scale * (Q2R tau * S) * G) with (scale * G * (Q2R tau * S)) by ring.
    rewrite powers; unfold Rdiv.
    match goal with |- IZR ?z * _ * _ * _ <= _ =>
      replace (IZR z * / G * (M ^ 2 * S) * G) with (IZR z * (M ^ 2 * S)) by (field; lra) end.
    assert (0 <= M ^ 2 * S) by (apply Rmult_le_pos; auto; apply pow2_ge_0).
    apply Rmult_le_compat_r with (r := M ^ 2 * S) in high; lra. }
  eapply Rle_trans; [|apply lighter, pow2_ge_0].
  right; f_equal; rewrite <- Rpow_mult_distr; f_equal.
  cbn [linear_value]; rewrite !variable_position by auto.
  assert (arm : linear_value variable
      (map (fun c => (rotated (place a) c, (- nth c (map (floor (metre P)) t) 0)%Z)) (dimensions d))
    = - (M * sum d (fun c => rho a c * number t c))).
  { assert (term : forall c, (c < 3)%nat ->
      IZR (- nth c (map (floor (metre P)) t) 0%Z) * variable (rotated (place a) c)
      = - (M * (rho a c * number t c))).
    { intros c small; rewrite variable_rotated, opp_IZR, number_floor by auto; unfold M; ring. }
    unfold dimensions, sum; destruct dimension as [-> | ->];
      cbn [seq map fold_right linear_value]; rewrite !term by lia; ring. }
  rewrite arm, opp_IZR; field; lra.
Qed.

(** rho_i Lam_i rho_i^T *)
Definition multiplier_value (Lam : list Z) (r : nat -> R) : R :=
  total (fun '((a, b), x) =>
    if Nat.eqb a b then IZR x * r a ^ 2 else 2 * IZR x * r a * r b) (combine (upper d) Lam).

Lemma multiplier_bound k Lam : placed k = true ->
  values variable (multiplier_forms d (place k) Lam) <= - multiplier_value Lam (rho k).
Proof.
  intros placed_k; unfold multiplier_value.
  rewrite <- (Rmult_1_l (total _ _)), Ropp_mult_distr_l, <- total_times.
  apply values_map; intros [[a b] x] found.
  apply in_combine_l, in_upper in found; assert (a < 3 /\ b < 3)%nat by lia.
  rewrite <- (variable_rotated k a), <- (variable_rotated k b) by (auto; tauto).
  destruct (Nat.eqb_spec a b) as [->|].
  - rewrite diagonal_value, opp_IZR; lra.
  - eapply Rle_trans; [apply product_bound with (c := - IZR x)|]; rewrite ?opp_IZR; lra.
Qed.

(** The part of an edge's cost in this row. *)
Definition row_cost (e : edge) : R :=
  Q2R (kappa e) * sum d (fun b =>
    (rho (j e) b - sum d (fun c => rho (i e) c * rotation (quaternion e) c b)) ^ 2) +
  Q2R (tau e) * (IZR (step P) / IZR (2 ^ metre P) * (pos (j e) - pos (i e))
                 - sum d (fun c => rho (i e) c * number (translation e) c)) ^ 2.

Lemma rotation_integer q x y z w :
  forallb (whole (turn P)) q = true -> map (floor (turn P)) q = [x; y; z; w] ->
  (0 < norm [x; y; z; w])%Z -> forall a b, (a < 3)%nat -> (b < 3)%nat ->
  rotation q a b = IZR (entry (matrix_of [x; y; z; w]) a b) / IZR (norm [x; y; z; w]).
Proof.
  intros exact same positive a b small_a small_b.
  pose proof (number_floor (turn P) q 0 turn_nonneg exact) as n0.
  pose proof (number_floor (turn P) q 1 turn_nonneg exact) as n1.
  pose proof (number_floor (turn P) q 2 turn_nonneg exact) as n2.
  pose proof (number_floor (turn P) q 3 turn_nonneg exact) as n3.
  rewrite same in n0, n1, n2, n3; cbn [nth] in n0, n1, n2, n3.
  assert (0 < IZR (2 ^ turn P)) by (apply pow_positive; auto).
  apply IZR_lt in positive; revert positive; unfold rotation, entry, matrix_of, norm.
  cbn -[Z.mul Z.add Z.sub Z.opp IZR].
  set (T := IZR (2 ^ turn P)) in *.
  destruct a as [|[|[|a]]]; try lia; destruct b as [|[|[|b]]]; try lia;
    cbn [nth]; repeat rewrite ?plus_IZR, ?minus_IZR, ?mult_IZR; rewrite n0, n1, n2, n3;
    intros; field; split; nra.
Qed.

Lemma edge_bound e : edge_test d P of_node at_place e = true ->
  values variable (edge_forms d P of_node e) <= scale * row_cost e.
Proof.
  unfold edge_test; intros tests.
  repeat (apply andb_prop in tests; destruct tests as [tests ?]).
  destruct (map (floor (turn P)) (quaternion e)) as [|x [|y [|z [|w [|]]]]] eqn:integers;
    try discriminate.
  repeat match goal with H : _ && _ = true |- _ => apply andb_prop in H; destruct H end.
  unfold edge_forms, row_cost; rewrite values_app, Rmult_plus_distr_l.
  apply Rplus_le_compat.
  - destruct (zero (kappa e)) eqn:no_kappa.
    + rewrite (zero_Q2R _ no_kappa); unfold values; simpl; lra.
    + rewrite integers; assert (0 < norm [x; y; z; w])%Z by (apply Z.ltb_lt; auto).
      eapply Rle_trans; [apply rotation_bound; auto|].
      * intros ->; match goal with H : _ && _ = true |- _ => apply andb_prop in H; destruct H end.
        split; apply Z.eqb_eq; auto.
      * right; do 2 f_equal; rewrite !sum_total; apply total_ext; intros b in_b.
        f_equal; f_equal; rewrite !sum_total; apply total_ext; intros c in_c.
        apply in_seq in in_b, in_c; erewrite rotation_integer by (eauto; lia); reflexivity.
  - destruct (zero (tau e)) eqn:no_tau.
    + rewrite (zero_Q2R _ no_tau); unfold values; simpl; lra.
    + apply translation_bound; auto.
Qed.

(** What the nonnegative form says about this row. *)
Lemma row_bound graph :
  forallb (edge_test d P of_node at_place) graph = true ->
  forallb (fun m => placed (fst m)) (multipliers P) = true ->
  placed (pin P) = true -> pos (pin P) = 0 ->
  values variable (all_forms d P of_node graph)
  <= scale * total row_cost graph
     - total (fun m => multiplier_value (snd m) (rho (fst m))) (multipliers P).
Proof.
  intros edges nodes_placed pin_placed pinned; unfold all_forms.
  change (values variable (?A :: ?B)) with (value variable A + values variable B).
  rewrite diagonal_value, values_app.
  fold place; rewrite (variable_position (pin P)), pinned by auto.
  assert (values variable (flat_map (edge_forms d P of_node) graph)
          <= total (fun e => scale * row_cost e) graph) as cost_part.
  { apply values_flat_map; intros e in_graph; apply edge_bound.
    rewrite forallb_forall in edges; auto. }
  rewrite total_times in cost_part.
  assert (values variable
            (flat_map (fun m => multiplier_forms d (place (fst m)) (snd m)) (multipliers P))
          <= total (fun m => -1 * multiplier_value (snd m) (rho (fst m))) (multipliers P))
    as multiplier_part.
  { apply values_flat_map; intros m in_proof; rewrite forallb_forall in nodes_placed.
    eapply Rle_trans; [apply multiplier_bound; auto|]; lra. }
  rewrite total_times in multiplier_part; lra.
Qed.
End Row.

(** * All rows *)

(** tr(R Lam R^T) = tr(Lam) where R^T R = I. *)
Lemma multiplier_trace d Lam (M : matrix) : orthogonal d M ->
  sum d (fun a => multiplier_value d Lam (M a)) = IZR (trace d Lam).
Proof.
  intros columns; unfold multiplier_value, trace; rewrite sum_total, total_exchange.
  rewrite <- total_IZR; apply total_ext; intros [[a b] x] found.
  apply in_combine_l, in_upper in found; destruct found as [small_a small_b].
  pose proof (columns a b small_a small_b) as product; rewrite sum_total in product.
  destruct (Nat.eqb a b) eqn:same.
  - apply Nat.eqb_eq in same; subst; transitivity (IZR x * 1); [|ring].
    rewrite <- product, <- total_times; apply total_ext; intros; ring.
  - transitivity (2 * IZR x * 0); [|ring].
    rewrite <- product, <- total_times; apply total_ext; intros; ring.
Qed.

Theorem bound_from_check d graph P L :
  check d graph P L = true -> no_estimate_costs_less_than (Q2R L) d graph.
Proof.
  unfold check; intros tests rot t rotations.
  set (numbered := enumerate 1 (map fst (multipliers P))) in tests.
  set (of_node := places numbered) in tests; set (at_place := nodes numbered) in tests.
  apply andb_prop in tests; destruct tests as [tests definite].
  apply andb_prop in tests; destruct tests as [tests edges].
  unfold proof_test in tests.
  repeat match goal with H : _ && _ = true |- _ => apply andb_prop in H; destruct H end.
  repeat match goal with
    | H : (_ <=? _)%Z = true |- _ => apply Z.leb_le in H
    | H : (_ <? _)%Z = true |- _ => apply Z.ltb_lt in H
  end.
  assert (d = 2%nat \/ d = 3%nat) as dimension.
  { match goal with H : (_ || _) = true |- _ => apply orb_prop in H; destruct H as [H|H] end;
      apply Nat.eqb_eq in H; auto. }
  pose (far := IZR (2 ^ metre P) / IZR (step P)).
  pose (pos a k := far * (t k a - t (pin P) a)).
  assert (0 < IZR (2 ^ metre P)) by (apply pow_positive; auto).
  assert (0 < IZR (step P)) by (apply IZR_lt; auto).
  assert (rows : forall a,
    0 <= IZR (2 ^ unit P) * total (row_cost d P (fun k => rot k a) (pos a)) graph
         - total (fun m => multiplier_value d (snd m) (rot (fst m) a)) (multipliers P)).
  { intros a; eapply Rle_trans; [|apply row_bound with (pos := pos a); eauto].
    - rewrite <- add_all_value; eapply nonnegative_value; apply definite.
    - unfold pos; ring. }
  assert (0 <= sum d (fun a =>
    IZR (2 ^ unit P) * total (row_cost d P (fun k => rot k a) (pos a)) graph
    + -1 * total (fun m => multiplier_value d (snd m) (rot (fst m) a)) (multipliers P))) as both.
  { rewrite sum_total; replace 0 with (total (fun _ : nat => 0) (seq 0 d))
      by (unfold total; induction (seq 0 d); simpl; lra).
    apply total_le; intros a _; specialize (rows a); lra. }
  rewrite sum_total, total_plus, !total_times in both.
  assert (total (fun a => total (fun m => multiplier_value d (snd m) (rot (fst m) a))
            (multipliers P)) (seq 0 d) = IZR (bound d P)) as traces.
  { unfold bound; rewrite total_exchange, <- total_IZR; apply total_ext; intros m _.
    apply multiplier_trace; auto. }
  assert (total (fun a => total (row_cost d P (fun k => rot k a) (pos a)) graph) (seq 0 d)
          = cost d graph rot t) as costs.
  { unfold cost; fold (total (edge_cost d rot t) graph); rewrite total_exchange; apply total_ext; intros e _.
    unfold row_cost, edge_cost; rewrite total_plus, !total_times, !sum_total; f_equal.
    f_equal; apply total_ext; intros a _; f_equal; f_equal.
    unfold pos, far; field; lra. }
  rewrite traces, costs in both.
  match goal with H : (_ <= bound d P * _)%Z |- _ => apply IZR_le in H; rename H into claim end.
  rewrite Z.shiftl_mul_pow2, !mult_IZR in claim by auto.
  assert (0 < IZR (2 ^ unit P)) by (apply pow_positive; auto).
  apply Rmult_le_reg_l with (IZR (2 ^ unit P)); auto.
  apply Rle_trans with (IZR (bound d P)); [|lra].
  apply Rmult_le_reg_r with (IZR (Zpos (Qden L))); [apply IZR_lt; reflexivity|].
  rewrite Rmult_assoc, Q2R_quotient; lra.
Qed.

(** The same for a decimal number that is written as a real number. *)
Corollary proved d graph P (L : Q) (decimal : R) :
  decimal <= Q2R L -> check d graph P L = true -> no_estimate_costs_less_than decimal d graph.
Proof.
  intros less tests rot t rotations; eapply Rle_trans; [apply less|].
  eapply bound_from_check; eauto.
Qed.
