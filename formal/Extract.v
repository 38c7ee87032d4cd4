(** The check as a program, for graphs that take the kernel too long. *)

From Coq Require Import Extraction ExtrOcamlBasic ExtrOcamlZBigInt.
From Certpgo Require Import Check.

Extraction "check.ml" check.
