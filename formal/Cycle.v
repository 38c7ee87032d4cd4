(** Six cameras in the plane: no estimate of their rotations costs less than 0.1714.

    Each camera sees the next one turned by 53.1 degrees, twice the arctangent of 1/2: the cosine
    is 3/5, the sine 4/5. After six such turns 41.2 degrees are missing to the full circle, so no
    rotations agree with all measurements. The best leave to each a sixth of that, which costs
    0.17231. The multipliers prove 12/70. The lesson "What a rounding error can do to a proof" does
    so by hand. *)

From Coq Require Import QArith Qreals Reals List Lra.
From Certpgo Require Import Statement Check Bound.
Import ListNotations.

Definition cycle : list edge := [
  Edge 0 1 [] [0; 0; 1; 2] 1 0;
  Edge 1 2 [] [0; 0; 1; 2] 1 0;
  Edge 2 3 [] [0; 0; 1; 2] 1 0;
  Edge 3 4 [] [0; 0; 1; 2] 1 0;
  Edge 4 5 [] [0; 0; 1; 2] 1 0;
  Edge 5 0 [] [0; 0; 1; 2] 1 0]%Q.

(** All multipliers are I / 70; the matrix is rounded to multiples of 2^-40. *)
Definition Lam : list Z := let x := (2 ^ 40 / 70)%Z in [x; 0%Z; x].
Definition cycle_proof : proof := Proof 40 0 0 1 40 0 0 0

  [(0, Lam); (1, Lam); (2, Lam); (3, Lam); (4, Lam); (5, Lam)]%Z.

Theorem no_better_rotations : no_estimate_costs_less_than 0.1714 2 cycle.
Proof.
  apply (proved _ _ cycle_proof 0.1714); [unfold Q2R; simpl; lra|].
  vm_cast_no_check (eq_refl true).
Qed.

Print Assumptions no_better_rotations.
