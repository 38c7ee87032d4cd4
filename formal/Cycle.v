(** Six cameras in the plane: no estimate of their rotations costs less than 0.0372.

    Each camera sees the next one turned by 63.2 degrees, twice the arctangent of 8/13: the cosine
    is 105/233, the sine 208/233. After six such turns one is 19.3 degrees beyond the full circle,
    so no rotations agree with all measurements. The best leave to each a sixth of that, which
    costs 0.03777. *)

From Coq Require Import QArith Qreals Reals List Lra.
From Certpgo Require Import Statement Check Bound.
Import ListNotations.

Definition cycle : list edge := [
  Edge 0 1 [] [0; 0; 8; 13] 1 0;
  Edge 1 2 [] [0; 0; 8; 13] 1 0;
  Edge 2 3 [] [0; 0; 8; 13] 1 0;
  Edge 3 4 [] [0; 0; 8; 13] 1 0;
  Edge 4 5 [] [0; 0; 8; 13] 1 0;
  Edge 5 0 [] [0; 0; 8; 13] 1 0]%Q.

(** All multipliers are 0.0031 I; the matrix is rounded to multiples of 2^-40. *)
Definition Lam : list Z := let x := (31 * 2 ^ 40 / 10000 + 1)%Z in [x; 0%Z; x].
Definition cycle_proof : proof := Proof 40 0 0 1 40 0 0 0

  [(0, Lam); (1, Lam); (2, Lam); (3, Lam); (4, Lam); (5, Lam)]%Z.

Theorem no_better_rotations : no_estimate_costs_less_than 0.0372 2 cycle.
Proof.
  apply (proved _ _ cycle_proof 0.0372); [unfold Q2R; simpl; lra|].
  vm_cast_no_check (eq_refl true).
Qed.

Print Assumptions no_better_rotations.
