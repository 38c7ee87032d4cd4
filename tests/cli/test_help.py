"""Help: groups, sections and narrow terminals; near matches and arguments in the wrong order."""

import pytest

from certpgo.cli import EXIT_CODES, command_names
from certpgo.cli._help import GROUPS, OTHERS, in_groups


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
    # A metavar is not broken; it alone may be wider than a very narrow terminal.
    assert max(map(len, text.splitlines())) <= max(columns, 72)


def test_common_options_of_solve_come_first(certpgo):
    text = certpgo("solve", "--help").out
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


def test_completion_names_files_and_datasets(square, monkeypatch):
    from certpgo.cli._options import graphs_beginning_with

    monkeypatch.chdir(square.parent)
    (square.parent / "squares").mkdir()
    assert graphs_beginning_with("squ") == ["square.g2o", "squares/"]
    assert "sphere2500" in graphs_beginning_with("sph")
    assert graphs_beginning_with(f"{square.parent}/square.") == [str(square)]


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
