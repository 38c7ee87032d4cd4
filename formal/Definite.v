(** Sparse quadratic forms with integer coefficients, and a test that one is nonnegative. *)

From Coq Require Import Reals ZArith List Bool Lra Lia.
Import ListNotations.
Local Open Scope Z_scope.

(** A linear form: pairs (s, z), the sum of z y_s. *)
Definition linear := list (positive * Z).

(** A row (r, z, tail) stands for z y_r^2 + 2 y_r (tail y), a form for the sum of its rows. *)
Definition row := (positive * Z * linear)%type.
Definition form := list row.

(** Sums of two. Both are kept in order; nothing below depends on that. *)
Fixpoint add_linear (u : linear) : linear -> linear :=
  fix merge (v : linear) : linear :=
    match u, v with
    | [], _ => v
    | _, [] => u
    | (r, x) :: u', (s, y) :: v' =>
      match Pos.compare r s with
      | Lt => (r, x) :: add_linear u' v
      | Gt => (s, y) :: merge v'
      | Eq => (r, x + y) :: add_linear u' v'
      end
    end.

Fixpoint add (A : form) : form -> form :=
  fix merge (B : form) : form :=
    match A, B with
    | [], _ => B
    | _, [] => A
    | (r, x, u) :: A', (s, y, v) :: B' =>
      match Pos.compare r s with
      | Lt => (r, x, u) :: add A' B
      | Gt => (s, y, v) :: merge B'
      | Eq => (r, x + y, add_linear u v) :: add A' B'
      end
    end.

(** The sum of many, in pairs of pairs. *)
Fixpoint pairs (forms : list form) : list form :=
  match forms with
  | A :: B :: others => add A B :: pairs others
  | _ => forms
  end.
Definition add_all (forms : list form) : form := fold_right add [] (Nat.iter 20 pairs forms).

(** What is left when (l0 y_r + sum l_s y_s)^2 is taken from a row r: of a column of triples
    (s, l_s, e_s) the rows of - (sum l_s y_s)^2 - sum e_s y_s^2. *)
Definition column := list (positive * Z * Z).

Fixpoint rest (l : column) : form :=
  match l with
  | [] => []
  | (s, x, e) :: l' =>
    let y := - x in (s, y * x - e, map (fun '(u, z, _) => (u, y * z)) l') :: rest l'
  end.

(** A column of a Cholesky factor, with e_s = |z_s - l0 l_s|. Any l0 and l_s would do. *)
Definition pivot (z : Z) (tail : linear) : Z :=
  Z.sqrt (z - Z.of_nat (length tail) * Z.sqrt z).

Definition quotient (z l0 : Z) : Z := (2 * z + l0) / (2 * l0).

Definition cholesky (l0 : Z) (tail : linear) : column :=
  map (fun '(s, z) => let x := quotient z l0 in (s, x, Z.abs (z - l0 * x))) tail.

Definition errors (l : column) : Z := fold_right Z.add 0 (map snd l).

Fixpoint nonnegative (fuel : nat) (A : form) : bool :=
  match A, fuel with
  | [], _ => true
  | _, O => false
  | (r, z, tail) :: A', S fuel' =>
    let l0 := pivot z tail in
    let l := cholesky l0 tail in
    (l0 * l0 + errors l <=? z) && nonnegative fuel' (add A' (rest l))
  end.

(** The values of forms. *)
Local Open Scope R_scope.

Section Values.
Variable y : positive -> R.

Fixpoint linear_value (u : linear) : R :=
  match u with [] => 0 | (s, z) :: u' => IZR z * y s + linear_value u' end.

Definition row_value (A : row) : R :=
  let '(r, z, tail) := A in IZR z * y r ^ 2 + 2 * y r * linear_value tail.

Fixpoint value (A : form) : R :=
  match A with [] => 0 | r :: A' => row_value r + value A' end.

Lemma add_linear_value u v : linear_value (add_linear u v) = linear_value u + linear_value v.
Proof.
  revert v; induction u as [|[r x] u IHu]; induction v as [|[s z] v IHv]; simpl; try lra.
  destruct (Pos.compare_spec r s) as [->| |]; simpl; rewrite ?IHu, ?plus_IZR; simpl; try lra.
  simpl in IHv; rewrite IHv; lra.
Qed.

Lemma add_value A B : value (add A B) = value A + value B.
Proof.
  revert B; induction A as [|[[r x] u] A IHA]; induction B as [|[[s z] v] B IHB]; simpl; try lra.
  destruct (Pos.compare_spec r s) as [->| |]; simpl; rewrite ?IHA, ?plus_IZR, ?add_linear_value;
    simpl; try lra.
  simpl in IHB; rewrite IHB; lra.
Qed.

Definition values (forms : list form) : R := fold_right Rplus 0 (map value forms).

Lemma pairs_values forms : values (pairs forms) = values forms.
Proof.
  enough (H : forall n forms, (length forms < n)%nat -> values (pairs forms) = values forms)
    by (apply (H (S (length forms))); lia).
  intros n; induction n as [|n IH]; intros [|A [|B others]] short; simpl in *; try lia; try lra.
  unfold values in *; simpl; rewrite IH, add_value by lia; lra.
Qed.

Lemma add_all_value forms : value (add_all forms) = values forms.
Proof.
  unfold add_all; transitivity (values (Nat.iter 20 pairs forms)).
  - generalize (Nat.iter 20 pairs forms) as l; induction l as [|A l IH]; unfold values in *; simpl.
    + lra.
    + rewrite add_value, IH; lra.
  - generalize 20%nat as n; induction n as [|n IH]; simpl; rewrite ?pairs_values; auto.
Qed.

Fixpoint column_value (l : column) : R :=
  match l with [] => 0 | (s, x, _) :: l' => IZR x * y s + column_value l' end.
Fixpoint error_value (l : column) : R :=
  match l with [] => 0 | (s, _, e) :: l' => IZR e * y s ^ 2 + error_value l' end.

Lemma rest_value l : value (rest l) = - column_value l ^ 2 - error_value l.
Proof.
  assert (scaled : forall c l, linear_value (map (fun '(u, z, _) => (u, (c * z)%Z)) l)
                               = IZR c * column_value l).
  { intros c m; induction m as [|[[u z] e] m IH]; simpl; [|rewrite IH, mult_IZR]; ring. }
  induction l as [|[[s x] e] l IH]; simpl rest; [simpl; lra|].
  cbn [value row_value column_value error_value].
  rewrite IH, scaled, minus_IZR, mult_IZR, opp_IZR; ring.
Qed.

(** 2 |e| |y_r y_s| <= |e| (y_r^2 + y_s^2) *)
Lemma error_bound z y_r y_s : - IZR (Z.abs z) * (y_r ^ 2 + y_s ^ 2) <= 2 * IZR z * y_r * y_s.
Proof.
  rewrite abs_IZR; unfold Rabs; pose proof (pow2_ge_0 (y_r - y_s)); pose proof (pow2_ge_0 (y_r + y_s));
  destruct (Rcase_abs (IZR z)); nra.
Qed.

Lemma cholesky_value l0 tail y_r :
  2 * y_r * (IZR l0 * column_value (cholesky l0 tail)) - error_value (cholesky l0 tail)
    - IZR (errors (cholesky l0 tail)) * y_r ^ 2
  <= 2 * y_r * linear_value tail.
Proof.
  unfold errors; induction tail as [|[s z] tail IH]; [simpl; lra|].
  cbn [cholesky map snd fold_right column_value error_value linear_value].
  fold (cholesky l0 tail); set (x := quotient z l0); set (e := (z - l0 * x)%Z).
  pose proof (error_bound e y_r (y s)) as bound.
  assert (IZR z = IZR l0 * IZR x + IZR e) as -> by
    (unfold e; rewrite minus_IZR, mult_IZR; lra).
  rewrite plus_IZR; lra.
Qed.

Theorem nonnegative_value fuel A : nonnegative fuel A = true -> 0 <= value A.
Proof.
  revert A; induction fuel as [|fuel IH]; intros [|[[r z] tail] A]; simpl; try lra; try discriminate.
  set (l0 := pivot z tail); set (l := cholesky l0 tail).
  intros tests; apply andb_prop in tests; destruct tests as [dominant others].
  apply Z.leb_le, IZR_le in dominant; rewrite plus_IZR, mult_IZR in dominant.
  apply IH in others; rewrite add_value, rest_value in others.
  pose proof (cholesky_value l0 tail (y r)) as bound; fold l in bound.
  assert (0 <= (IZR l0 * y r + column_value l) ^ 2) by apply pow2_ge_0.
  assert (0 <= y r ^ 2) by apply pow2_ge_0.
  nra.
Qed.
End Values.
