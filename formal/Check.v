(** The check of a proof, in integers: what Coq computes. *)

From Coq Require Import ZArith QArith List Bool FMapPositive.
From Certpgo Require Import Statement Definite.
Import ListNotations.
Local Open Scope Z_scope.

(** A proof that no estimate costs less than some L. Nothing in it is trusted. *)
Record proof := Proof {
  unit : Z;         (* entries of the matrix are multiples of 2^-unit *)
  metre : Z;        (* translations are multiples of 2^-metre ... *)
  turn : Z;         (* ... and quaternions of 2^-turn *)
  step : Z;         (* a position is measured in units of step 2^-metre *)
  rotation_guard : Z;      (* more bits of kappa / |q|^2 ... *)
  translation_guard : Z;   (* ... and of tau *)
  pin : Z;          (* the node at the origin ... *)
  stiffness : Z;    (* ... and what is added to its diagonal entry *)
  multipliers : list (Z * list Z)
    (* all nodes in order of elimination, with the upper triangle of Lam_i, row by row *)
}.

(** The product of a rational number and a power of two, rounded down, and whether that is exact. *)
Definition floor (bits : Z) (q : Q) : Z := Z.shiftl (Qnum q) bits / Zpos (Qden q).
Definition whole (bits : Z) (q : Q) : bool :=
  floor bits q * Zpos (Qden q) =? Z.shiftl (Qnum q) bits.

Definition norm (q : list Z) : Z := fold_right (fun x s => x * x + s) 0 q.

(** |q|^2 R(q) *)
Definition matrix_of (q : list Z) : list (list Z) :=
  let x := nth 0 q 0 in let y := nth 1 q 0 in let z := nth 2 q 0 in let w := nth 3 q 0 in
  let xx := x*x in let yy := y*y in let zz := z*z in let ww := w*w in
  let xy := x*y in let xz := x*z in let yz := y*z in
  let wx := w*x in let wy := w*y in let wz := w*z in
  [[ww + xx - yy - zz; 2 * (xy - wz); 2 * (xz + wy)];
   [2 * (xy + wz); ww - xx + yy - zz; 2 * (yz - wx)];
   [2 * (xz - wy); 2 * (yz + wx); ww - xx - yy + zz]].
Definition entry (N : list (list Z)) (a b : nat) : Z := nth b (nth a N []) 0.

(** The variables of the node at place p: its position, and a row of its rotation. *)
Definition position (p : positive) : positive := (p~0~0)%positive.
Definition rotated (p : positive) (a : nat) : positive :=
  match a with O => p~0~1 | S O => p~1~0 | _ => p~1~1 end%positive.

(** z y_r^2, and 2 z y_r y_s or, since z was rounded down by less than 1, somewhat less. *)
Definition diagonal (r : positive) (z : Z) : form := [(r, z, [])].
Definition product (r s : positive) (z : Z) : form :=
  if Pos.ltb r s then [(r, -1, [(s, z)]); (s, -1, [])] else [(s, -1, [(r, z)]); (r, -1, [])].

(** 2^-bits w u(y)^2 *)
Fixpoint square (bits : Z) (w : Z) (u : linear) : list form :=
  match u with
  | [] => []
  | (r, x) :: u' =>
    let wx := x * w in
    diagonal r (Z.shiftr (x * wx) bits)
    :: map (fun '(s, z) => product r s (Z.shiftr (z * wx) bits)) u' ++ square bits w u'
  end.

Section Check.
Variable d : nat.
Variable P : proof.

Definition dimensions : list nat := seq 0 d.

(** 2^-rotation_guard k (D |rho_j|^2 + D |rho_i|^2 - 2 rho_i N rho_j^T), N/D the rotation R_ij, and
    rho_i a row of R_i: the rest of kappa |rho_j - rho_i R_ij|^2 is not negative. *)
Definition rotation_forms (p q : positive) (kappa : Q) (r : list Z) : list form :=
  let D := norm r in let N := matrix_of r in
  let k := floor (unit P + rotation_guard P) kappa / D in
  let kD := Z.shiftr (k * D) (rotation_guard P) in
  flat_map (fun a => [diagonal (rotated p a) kD; diagonal (rotated q a) kD]) dimensions ++
  flat_map (fun a => map (fun b => product (rotated p a) (rotated q b)
    (Z.shiftr (- k * entry N a b) (rotation_guard P))) dimensions) dimensions.

(** tau |t_j - t_i - rho_i t_ij|^2 *)
Definition translation_forms (p q : positive) (tau : Q) (t : list Z) : list form :=
  square (translation_guard P) (floor (unit P + translation_guard P - 2 * metre P) tau)
    ((position q, step P) :: (position p, - step P) ::
     map (fun c => (rotated p c, - nth c t 0)) dimensions).

(** - rho_i Lam_i rho_i^T *)
Definition upper : list (nat * nat) :=
  flat_map (fun a => map (fun b => (a, b)) (seq a (d - a))) dimensions.

Definition multiplier_forms (p : positive) (Lam : list Z) : list form :=
  map (fun '((a, b), x) => if Nat.eqb a b then diagonal (rotated p a) (- x) else
    product (rotated p a) (rotated p b) (- x)) (combine upper Lam).

Definition trace (Lam : list Z) : Z :=
  fold_right Z.add 0 (map (fun '((a, b), x) => if Nat.eqb a b then x else 0) (combine upper Lam)).

(** Places of nodes in the order of elimination. *)
Definition key (k : Z) : positive :=
  match k with Z0 => 1 | Zpos p => p~0 | Zneg p => p~1 end%positive.

Fixpoint enumerate (next : positive) (nodes : list Z) : list (Z * positive) :=
  match nodes with [] => [] | k :: others => (k, next) :: enumerate (Pos.succ next) others end.

Definition places (numbered : list (Z * positive)) : PositiveMap.t positive :=
  fold_right (fun '(k, p) => PositiveMap.add (key k) p) (PositiveMap.empty _) numbered.
Definition nodes (numbered : list (Z * positive)) : PositiveMap.t Z :=
  fold_right (fun '(k, p) => PositiveMap.add p k) (PositiveMap.empty _) numbered.

Variable of_node : PositiveMap.t positive.
Variable at_place : PositiveMap.t Z.

Definition place (k : Z) : positive :=
  match PositiveMap.find (key k) of_node with Some p => p | None => 1%positive end.
Definition node (p : positive) : Z :=
  match PositiveMap.find p at_place with Some k => k | None => 0 end.
Definition placed (k : Z) : bool := node (place k) =? k.

Definition zero (q : Q) : bool := Qnum q =? 0.

Definition edge_forms (e : edge) : list form :=
  let p := place (i e) in let q := place (j e) in
  (if zero (kappa e) then [] else
    rotation_forms p q (kappa e) (map (floor (turn P)) (quaternion e))) ++
  (if zero (tau e) then [] else
    translation_forms p q (tau e) (map (floor (metre P)) (translation e))).

Definition edge_test (e : edge) : bool :=
  placed (i e) && placed (j e) &&
  forallb (whole (metre P)) (translation e) &&
  match map (floor (turn P)) (quaternion e) with
  | [x; y; z; w] =>
    forallb (whole (turn P)) (quaternion e) && (0 <? norm [x; y; z; w]) &&
    match d with 2%nat => (x =? 0) && (y =? 0) | _ => true end
  | _ => false
  end.

Definition all_forms (graph : list edge) : list form :=
  diagonal (position (place (pin P))) (stiffness P) ::
  flat_map edge_forms graph ++
  flat_map (fun m => multiplier_forms (place (fst m)) (snd m)) (multipliers P).

Definition bound : Z := fold_right Z.add 0 (map (fun m => trace (snd m)) (multipliers P)).

Definition proof_test (L : Q) : bool :=
  (Nat.eqb d 2 || Nat.eqb d 3) &&
  (0 <=? unit P) && (0 <=? metre P) && (0 <=? turn P) && (0 <? step P) &&
  (0 <=? rotation_guard P) && (0 <=? translation_guard P) &&
  (2 * metre P <=? unit P + translation_guard P) &&
  (Z.shiftl (Qnum L) (unit P) <=? bound * Zpos (Qden L)) &&
  forallb (fun m => placed (fst m)) (multipliers P) && placed (pin P).
End Check.

Definition check (d : nat) (graph : list edge) (P : proof) (L : Q) : bool :=
  let numbered := enumerate 1 (map fst (multipliers P)) in
  let of_node := places numbered in let at_place := nodes numbered in
  proof_test d P of_node at_place L && forallb (edge_test d P of_node at_place) graph &&
  let A := add_all (all_forms d P of_node graph) in nonnegative (length A) A.
