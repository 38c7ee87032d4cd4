(** What is proven: the cost of a pose graph, and that no estimate costs less than L.

    What has to be believed is in this file alone. R_i turns body i into the world, t_i is its
    position there, and an edge measures R_ij ~ R_i^T R_j and t_ij ~ R_i^T (t_j - t_i), as in
    docs/concepts/conventions.md and SE-Sync (Rosen et al., IJRR 2019, problem 1). *)

From Coq Require Import Reals QArith Qreals List.
Import ListNotations.
Local Open Scope R_scope.

Definition vector := nat -> R.
Definition matrix := nat -> nat -> R.

(** The sum of f 0, ..., f (d - 1). *)
Definition sum (d : nat) (f : nat -> R) : R := fold_right Rplus 0 (map f (seq 0 d)).

(** M^T M = I. Rotations are such matrices, and so are reflections. *)
Definition orthogonal (d : nat) (M : matrix) : Prop :=
  forall a b, (a < d)%nat -> (b < d)%nat ->
  sum d (fun c => M c a * M c b) = if Nat.eqb a b then 1 else 0.

(** A measurement of node j in the frame of node i. Its numbers are rational. *)
Record edge := Edge {
  i : Z; j : Z;
  translation : list Q;  (* t_ij *)
  quaternion : list Q;   (* x y z w, of any norm but 0; in the plane 0 0 sin cos of half the angle *)
  kappa : Q;             (* the weight of the rotation *)
  tau : Q                (* the weight of the translation *)
}.

Definition number (numbers : list Q) (k : nat) : R := Q2R (nth k numbers 0%Q).

(** R_ij: the matrix of v -> q v q* / |q|^2, entry by entry. *)
Definition rotation (q : list Q) : matrix := fun a b =>
  let x := number q 0 in let y := number q 1 in let z := number q 2 in let w := number q 3 in
  nth b (nth a [[w*w + x*x - y*y - z*z; 2 * (x*y - w*z); 2 * (x*z + w*y)];
                [2 * (x*y + w*z); w*w - x*x + y*y - z*z; 2 * (y*z - w*x)];
                [2 * (x*z - w*y); 2 * (y*z + w*x); w*w - x*x - y*y + z*z]] []) 0
  / (x*x + y*y + z*z + w*w).

(** kappa |R_j - R_i R_ij|_F^2 + tau |t_j - t_i - R_i t_ij|^2 *)
Definition edge_cost (d : nat) (rot : Z -> matrix) (t : Z -> vector) (e : edge) : R :=
  Q2R (kappa e) * sum d (fun a => sum d (fun b =>
    (rot (j e) a b - sum d (fun c => rot (i e) a c * rotation (quaternion e) c b)) ^ 2)) +
  Q2R (tau e) * sum d (fun a =>
    (t (j e) a - t (i e) a - sum d (fun c => rot (i e) a c * number (translation e) c)) ^ 2).

Definition cost (d : nat) (graph : list edge) (rot : Z -> matrix) (t : Z -> vector) : R :=
  fold_right Rplus 0 (map (edge_cost d rot t) graph).

Definition no_estimate_costs_less_than (L : R) (d : nat) (graph : list edge) : Prop :=
  forall (rot : Z -> matrix) (t : Z -> vector),
  (forall k, orthogonal d (rot k)) -> L <= cost d graph rot t.
