"""Options that exclude or need each other: the tables of all commands, and what reads them."""

import inspect
from importlib import import_module

import pytest

from certpgo import InputError
from certpgo.cli import _function, _own_commands
from certpgo.cli._rules import Rule, refuse

MODULES = {name: import_module(f"certpgo.cli.{name}") for name in sorted(_own_commands())}
ROWS = [
    pytest.param(name, rule, id=f"{name}-{rule.said[:40]}")
    for name, module in MODULES.items()
    for rule in getattr(module, "RULES", ())
]
#: What commands find, in rules that are tried later.
FACTS = {"several", "part"}


def options_of(rule):
    terms = [*rule.given, *([rule.without] if rule.without else [])]
    return {one.partition("=")[0] for term in terms for one in term.split("|")}


def values_of(rule):
    """Options, each with a value, of which the rule is about the first ones that suffice."""
    firsts = (term.split("|")[0].partition("=") for term in rule.given)
    return {name: pattern.replace("*", "s") or "x" for name, _, pattern in firsts}


@pytest.mark.parametrize(("command", "rule"), ROWS)
def test_a_rule_is_about_options_that_the_command_has(command, rule):
    assert options_of(rule) <= {*inspect.signature(_function(command)).parameters}


@pytest.mark.parametrize("command", ["solve", "certify"])
def test_later_rules_are_about_outputs_and_facts(command):
    known = {*inspect.signature(_function(command)).parameters, *FACTS}
    assert all(options_of(rule) <= known for rule in MODULES[command].OF_PARTS)


@pytest.mark.parametrize(("command", "rule"), ROWS)
def test_a_rule_refuses_what_it_says_and_no_less(command, rule):
    values = values_of(rule)
    with pytest.raises(InputError) as refused:
        refuse([rule], **values)
    assert "{" not in str(refused.value)
    with pytest.raises(InputError):
        refuse(MODULES[command].RULES, **values)
    for name in values:
        refuse([rule], **{**values, name: None})
        refuse([rule], **{**values, name: False})
    for one in filter(None, rule.without.split("|")):
        name, _, pattern = one.partition("=")
        refuse([rule], **{**values, name: pattern.lstrip("?").replace("*", "x") or "x"})


def test_of_alternatives_the_first_that_is_given_is_named():
    rule = Rule("--{option} of {b_c}: not with --d", "a|b_c", "d")
    with pytest.raises(InputError, match=r"--b-c of 0\.0: not with --d"):
        refuse([rule], b_c=0.0, d=True)
    refuse([rule], b_c=0.0)


def test_a_value_that_is_the_default_is_not_given(certpgo, square, tmp_path):
    done = certpgo("solve", square, "--certify", "--file-start", "--robust")
    assert done.code == 0
    done = certpgo("solve", square, "--no-certify")
    assert (done.code, done.err) == (1, "certpgo: --no-certify needs --method\n")
