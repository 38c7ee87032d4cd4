(** That Statement.v says what it should: what follows from its definitions. *)

From Coq Require Import Reals QArith Qreals List Lra Lia.
From Certpgo Require Import Statement.
Import ListNotations.
Local Open Scope R_scope.

(** The measured R_ij is a rotation: its columns are orthonormal, and its determinant is 1. *)
Theorem measured_rotations_are_rotations x y z w :
  let norm := Q2R x * Q2R x + Q2R y * Q2R y + Q2R z * Q2R z + Q2R w * Q2R w in
  let M := rotation [x; y; z; w] in
  norm <> 0 ->
  orthogonal 3 M /\
  M 0%nat 0%nat * (M 1%nat 1%nat * M 2%nat 2%nat - M 1%nat 2%nat * M 2%nat 1%nat) -
  M 0%nat 1%nat * (M 1%nat 0%nat * M 2%nat 2%nat - M 1%nat 2%nat * M 2%nat 0%nat) +
  M 0%nat 2%nat * (M 1%nat 0%nat * M 2%nat 1%nat - M 1%nat 1%nat * M 2%nat 0%nat) = 1.
Proof.
  intros norm M nonzero; unfold norm, M, rotation, orthogonal, number, sum in *; simpl; split.
  - intros a b small_a small_b.
    destruct a as [|[|[|a]]]; try lia; destruct b as [|[|[|b]]]; try lia; simpl; field; auto.
  - field; auto.
Qed.

(** Sine and cosine of half of 90 degrees: the axis x of body j is the axis y of body i. *)
Example quarter_turn :
  let M := rotation [0; 0; 1; 1]%Q in
  M 0%nat 0%nat = 0 /\ M 1%nat 0%nat = 1 /\ M 0%nat 1%nat = -1 /\ M 1%nat 1%nat = 0.
Proof. unfold rotation, number, Q2R; simpl; repeat split; field. Qed.

(** An estimate that agrees with a measurement costs nothing. *)
Theorem agreement_costs_nothing d rot t e :
  (forall a b, rot (j e) a b = sum d (fun c => rot (i e) a c * rotation (quaternion e) c b)) ->
  (forall a, t (j e) a = t (i e) a + sum d (fun c => rot (i e) a c * number (translation e) c)) ->
  edge_cost d rot t e = 0.
Proof.
  assert (zero : forall f, (forall a : nat, f a = 0) -> sum d f = 0).
  { intros f vanishes; unfold sum; induction (seq 0 d); simpl; [|rewrite vanishes]; lra. }
  intros turned moved; unfold edge_cost; rewrite !zero; [ring| |].
  - intros a; rewrite moved; ring.
  - intros a; apply zero; intros b; rewrite turned; ring.
Qed.

(** Half a turn too many costs 8 kappa in the plane, and a metre too many costs tau. *)
Example disagreement :
  let identity := fun (_ : Z) a b => if Nat.eqb a b then 1 else 0 in
  let apart := fun k a => if Nat.eqb a 0 then IZR (3 * k) else 0 in
  edge_cost 2 identity apart (Edge 0 1 [2; 0] [0; 0; 1; 0] 5 7)%Q = 8 * 5 + 7.
Proof. unfold edge_cost, rotation, number, Q2R, sum; simpl; field. Qed.
