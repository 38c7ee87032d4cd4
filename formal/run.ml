(* Runs the check that Coq extracts, on a file of certificate.py: run NAME.v *)

open Check
module B = Big_int_Z

let fail line = failwith ("not understood: " ^ line)

(* A hexadecimal double, exactly, or an integer. *)
let rational word =
  let number, exponent =
    match String.index_opt word 'p' with
    | Some k ->
        ( String.sub word 0 k,
          int_of_string (String.sub word (k + 1) (String.length word - k - 1) |> fun s ->
            if s.[0] = '+' then String.sub s 1 (String.length s - 1) else s) )
    | None -> (word, 0)
  in
  let whole, fraction =
    match String.split_on_char '.' number with
    | [ whole ] -> (whole, "")
    | [ whole; fraction ] -> (whole, fraction)
    | _ -> fail word
  in
  let exponent = exponent - (4 * String.length fraction) in
  let power = B.power_int_positive_int 2 (abs exponent) in
  let digits = B.big_int_of_string (whole ^ fraction) in
  if exponent < 0 then { qnum = digits; qden = power }
  else { qnum = B.mult_big_int digits power; qden = B.unit_big_int }

(* The bound's decimals, exactly. *)
let decimal word =
  match String.split_on_char '.' word with
  | [ whole ] -> { qnum = B.big_int_of_string whole; qden = B.unit_big_int }
  | [ whole; fraction ] ->
      { qnum = B.big_int_of_string (whole ^ fraction);
        qden = B.power_int_positive_int 10 (String.length fraction) }
  | _ -> fail word

(* Words and brackets. *)
let words line =
  let spaced = Buffer.create 256 in
  String.iter
    (function
      | ('[' | ']' | '^') as c -> Buffer.add_string spaced (Printf.sprintf " %c " c)
      | ';' | '(' | ')' | ',' -> Buffer.add_char spaced ' '
      | c -> Buffer.add_char spaced c)
    line;
  List.filter (( <> ) "") (String.split_on_char ' ' (Buffer.contents spaced))

let rec until_bracket read = function
  | "]" :: rest -> ([], rest)
  | word :: rest ->
      let numbers, rest = until_bracket read rest in
      (read word :: numbers, rest)
  | [] -> failwith "a bracket is not closed"

let integer = B.big_int_of_string
let power k = B.power_int_positive_int 2 (int_of_string k)

let rec nat = function 0 -> O | k -> S (nat (k - 1))

type file = { edges : edge list; made : proof option; claim : (string * string * string) option }

(* A line more of the file; edges and multipliers in reverse. *)
let add file line =
  match words line with
  | "Edge" :: i :: j :: "[" :: rest -> (
      match until_bracket rational rest with
      | translation, "[" :: rest -> (
          match until_bracket rational rest with
          | quaternion, kappa :: tau :: ([] | "]" :: _) ->
              let i, j, kappa, tau = (integer i, integer j, rational kappa, rational tau) in
              { file with edges = { i; j; translation; quaternion; kappa; tau } :: file.edges }
          | _ -> fail line)
      | _ -> fail line)
  | [ "Definition"; _; ":"; "proof"; ":="; "Proof"; u; m; t; "2"; "^"; s; g; h; pin; "2"; "^"; w; "[" ]
    ->
      { file with made = Some
            { unit0 = integer u; metre = integer m; turn = integer t; step = power s;
              rotation_guard = integer g; translation_guard = integer h; pin = integer pin;
              stiffness = power w; multipliers = [] } }
  | k :: "[" :: rest when line.[0] = '(' -> (
      match (until_bracket integer rest, file.made) with
      | (multiplier, ([] | "]" :: _)), Some p ->
          { file with made = Some { p with multipliers = (integer k, multiplier) :: p.multipliers } }
      | _ -> fail line)
  | [ "Theorem"; name; ":"; "no_estimate_costs_less_than"; bound; d; _ ] ->
      { file with claim = Some (name, bound, d) }
  | _ -> file

let () =
  let channel = open_in Sys.argv.(1) in
  let rec lines file =
    match input_line channel with
    | line -> lines (add file line)
    | exception End_of_file -> file
  in
  match lines { edges = []; made = None; claim = None } with
  | { edges; made = Some p; claim = Some (name, bound, d) } ->
      let p = { p with multipliers = List.rev p.multipliers } in
      if check (nat (int_of_string d)) (List.rev edges) p (decimal bound) then
        Printf.printf "%s: no estimate costs less than %s (%d edges)\n" name bound (List.length edges)
      else (Printf.printf "%s: not proven\n" name; exit 1)
  | _ -> failwith "no graph, proof and theorem"
