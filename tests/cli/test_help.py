"""Help: groups, sections and narrow terminals; near matches and arguments in the wrong order."""

import shlex

import pytest

from certpgo.cli import EXIT_CODES, _completion, command_names
from certpgo.cli._help import GROUPS, LINES, OTHERS, in_groups


def test_every_command_is_in_one_group_and_most_used_groups_come_first():
    names = command_names()
    groups = in_groups(names)
    assert OTHERS not in groups
    assert sorted(name for listed in groups.values() for name in listed) == sorted(names)
    assert next(iter(groups)) == "Solve and certify"
    assert in_groups(["mine", "solve"]) == {"Solve and certify": ["solve"], OTHERS: ["mine"]}


def test_help_has_the_groups_as_headings(certpgo):
    text = certpgo("--help").out
    places = [text.index(f"\n{group}:\n") for group in in_groups(command_names())]
    assert places == sorted(places)
    assert next(iter(GROUPS)) in text
    assert "--install-completion" in text


@pytest.mark.parametrize("columns", [60, 80])
@pytest.mark.parametrize("name", command_names())
def test_no_line_is_wide_and_no_option_is_broken(certpgo, monkeypatch, name, columns):
    import typer.main

    from certpgo.cli import application

    monkeypatch.setenv("COLUMNS", str(columns))
    text = certpgo(name, "--help").out
    own = typer.main.get_command(application([name])).commands[name]
    for parameter in own.params:
        if not parameter.hidden:
            for option in parameter.opts if parameter.param_type_name == "option" else ():
                assert any(option in line.replace(",", " ").split() for line in text.splitlines())
    assert "…" not in text
    assert "Examples:\n" in text
    if columns == 80:
        assert len(text.splitlines()) <= LINES
    # A metavar is not broken; it alone may be wider than a very narrow terminal.
    assert max(map(len, text.splitlines())) <= max(columns, 72)


def test_common_options_of_solve_come_first(certpgo):
    text = certpgo("solve", "--help-all").out
    order = ["--cost", "-o, --out", "--html", "--json", "How it is solved", "--method", "Reading"]
    places = [text.index(f"\n{start}{word}") for word in order for start in ("  " * ("-" in word),)]
    assert places == sorted(places)


def test_a_file_with_a_similar_name_is_named(certpgo, square):
    for given in (square.with_name("sqare.g2o"), square.with_name("Square.txt")):
        done = certpgo("solve", given)
        assert done.code == 1
        assert f"did you mean {square}?" in done.err


@pytest.mark.parametrize("command", ["certify", "bounds"])
@pytest.mark.parametrize("suffix", [".tum", ".g2o"])
def test_swapped_arguments_are_recognised(certpgo, square, tmp_path, command, suffix):
    estimate = tmp_path / f"estimate{suffix}"
    assert certpgo("solve", square, "-o", estimate).code == 0
    done = certpgo(command, estimate, square)
    assert done.code == 1
    assert done.err.strip().endswith(f"graph comes first: certpgo {command} {square} {estimate}")
    done = certpgo(command, estimate, estimate)
    assert done.code == 1
    assert "comes first" not in done.err


def test_a_proof_before_its_graph_is_recognised(certpgo, square, tmp_path):
    proof = tmp_path / "square.cert"
    assert certpgo("solve", square, "--proof", proof).code == 0
    done = certpgo("check", proof, square)
    assert done.code == 1
    assert done.err.strip().endswith(f"graph comes first: certpgo check {square} {proof}")


def test_all_of_the_help_explains_what_the_short_one_names(certpgo):
    short, whole = certpgo("solve", "--help").out, certpgo("solve", "--help-all").out
    assert "More (certpgo solve --help-all):" in short
    assert "More" not in whole
    for said in ("Which components of a disconnected graph to use.", "Probability of --regions"):
        assert said in whole
        assert said not in short
    assert certpgo("check", "--help").out == certpgo("check", "--help-all").out


@pytest.mark.parametrize("name", command_names())
def test_examples_are_command_lines_that_are_understood(name):
    import typer.main

    from certpgo.cli import application

    own = typer.main.get_command(application([name])).commands[name]
    assert own.epilog
    for line in own.epilog.splitlines():
        words = shlex.split(line)
        words = words[words.index("certpgo") + 1 :]
        assert words[0] == name
        own.make_context(name, words[1:])  # wrong options raise
        assert len(line) <= 70


def test_completion_names_files_and_datasets(square, monkeypatch):
    monkeypatch.chdir(square.parent)
    (square.parent / "squares").mkdir()
    assert _completion.graphs("squ") == ["square.g2o", "squares/"]
    assert "sphere2500" in _completion.graphs("sph")
    assert "sphere2500_groundtruth" not in _completion.graphs("sph")
    assert "sphere2500_groundtruth" in _completion.inputs("sph")
    assert _completion.graphs(f"{square.parent}/square.") == [str(square)]


@pytest.mark.parametrize(
    ("begun", "offered"),
    [
        (["solve", "x", "--method", "block"], {"block_coordinate_descent"}),
        (["solve", "x", "--cost", ""], {"chordal", "g2o", "gtsam"}),
        (["solve", "x", "--format", "tu"], {"tum"}),
        (["solve", "x", "--tier", "p"], {"proof"}),
        (["compare", "x", "--methods", "newton,block"], {"newton,block_coordinate_descent"}),
        (["fetch", "torus3"], {"torus3D"}),
        (["list", "me"], {"methods"}),
        (["reproduce", "eriksson2018_t"], {"eriksson2018_table1", "eriksson2018_table2"}),
    ],
)
def test_a_shell_is_offered_the_values_of_options(certpgo, monkeypatch, begun, offered):
    monkeypatch.setenv("_CERTPGO_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", " ".join(["certpgo", *begun]))
    monkeypatch.setenv("COMP_CWORD", str(len(begun)))
    assert {*certpgo().out.split()} == offered


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("--keep", "foo"), "'foo' is not one of all, first, last."),
        (("--time-limit", "x"), "'x' is not a number of at least 0."),
        (("--max-rank", "1"), "'1' is not a whole number of at least 2."),
        (("--kappa", "x"), "'x' is not a number."),
    ],
)
def test_a_wrong_value_is_told_in_our_words(certpgo, square, given, said):
    assert certpgo("solve", square, *given).err.endswith(f"{said}\n")


def test_the_wrong_one_of_several_values_is_named(certpgo):
    assert "'nothing' is not one of methods," in certpgo("list", "methods", "nothing").err


def test_outputs_have_the_same_names(certpgo):
    for name in ("solve", "certify", "view", "reconstruct"):
        text = certpgo(name, "--help").out
        assert "-o, --out" in text, name
        assert "--html" in text, name
    for name in ("merge", "sparsify", "follow", "outliers", "compare", "register"):
        assert "-o, --out" in certpgo(name, "--help").out, name


@pytest.mark.parametrize("columns", [80, 120])
def test_no_cell_of_a_table_is_cut(certpgo, square, monkeypatch, columns):
    monkeypatch.setattr("certpgo.cli._show._terminal", lambda: columns)
    text = certpgo("bounds", square).out
    words = " ".join(text.split())
    assert max(map(len, text.splitlines())) <= columns
    for sentence in certpgo("bounds", square, "--json").json["bounds"]:
        for word in sentence["says"].split():
            assert word in words


def test_a_table_that_does_not_fit_is_a_list(certpgo, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    text = certpgo("list", "datasets").out
    assert "\nsphere2500\n  holds: graph\n  d: 3\n  nodes: 2500\n" in text
    assert "─" not in text


def test_the_usage_line_has_dots_once(certpgo):
    assert (
        certpgo("solve", "--help").out.splitlines()[0] == "Usage: certpgo solve [OPTIONS] GRAPH..."
    )


@pytest.mark.parametrize(
    ("given", "code"),
    [
        ((), 2),
        (("nothing",), 2),
        (("solve",), 2),
        (("solve", "{}", "--nothing"), 2),
        (("solve", "{}", "--cost", "nothing"), 2),
        (("solve", "{}", "--time-limit", "x"), 2),
        (("list", "nothing"), 2),
        (("solve", "{}", "--method", "nothing"), 1),
        (("solve", "{}", "--method", "newton", "--set", "nothing=1"), 1),
        (("solve", "{}", "-o", "out.nothing"), 1),
        (("solve", "{}", "--quantile", "0.9"), 1),
        (("compare", "{}", "--methods", "nothing"), 1),
        (("fetch", "nothing"), 1),
        (("check", "{}", "nothing.cert"), 1),
        (("prove", "nothing.g2o"), 1),
    ],
)
def test_exit_codes_are_those_of_the_help(certpgo, square, given, code):
    done = certpgo(*(word.format(square) for word in given))
    assert done.code == code
    said = done.out + done.err
    assert ("Usage: certpgo" in said) == (code == 2)
    assert EXIT_CODES[1].startswith("unusable input, unknown name")
    assert "printed usage" in EXIT_CODES[2]
