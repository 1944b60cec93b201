"""Completion of commands, options and their values in a shell, from what the parser knows."""

import argparse

_BASH = """\
_bsp_gp() {{
    local word="${{COMP_WORDS[COMP_CWORD]}}" words="" first="" values=""
    case "${{COMP_WORDS[1]}}" in
{cases}
    esac
    case "${{COMP_WORDS[1]}} ${{COMP_WORDS[COMP_CWORD-1]}}" in
{choices}
    esac
    if [ -n "$values" ]; then words="$values"
    elif [ "$COMP_CWORD" = 1 ]; then words="{commands} --help --version"
    elif [ "${{word:0:1}}" != - ]; then
        words=""
        [ "$COMP_CWORD" = 2 ] && words="$first"
    fi
    COMPREPLY=($(compgen -W "$words" -- "$word"))
}}
complete -o default -F _bsp_gp bsp-gp
"""


def completion_script(parser, shell, names=()):
    """What a shell reads to complete ``bsp-gp``: bash's own; zsh takes it with bashcompinit.

    Parameters
    ----------
    shell : {"bash", "zsh"}
    names : mapping of str to sequence of str
        Command -> what its first argument may be, where its parser does not say so.
    """
    commands, cases, choices = _commands(parser), [], []
    for name, each in commands.items():
        within = _commands(each)
        options = dict.fromkeys(o for p in (each, *within.values()) for o in _options(p))
        first = [*within, *_first(each), *dict(names).get(name, ())]
        cases.append(f'        {name}) words="{" ".join(options)}" first="{" ".join(first)}" ;;')
        for p in (each, *within.values()):
            choices += [
                f'        "{name} {option}") values="{" ".join(map(str, action.choices))}" ;;'
                for action in p._actions if action.choices
                for option in action.option_strings
            ]  # fmt: skip
    head = "autoload -U +X bashcompinit && bashcompinit\n" if shell == "zsh" else ""
    return head + _BASH.format(
        cases="\n".join(cases), choices="\n".join(choices), commands=" ".join(commands)
    )


def _commands(parser):
    """Parsers of what a command is made of, by name."""
    return next((a.choices for a in parser._actions
                 if isinstance(a, argparse._SubParsersAction)), {})  # fmt: skip


def _first(parser):
    """What the first argument of a command may be, where it is a choice."""
    return next((tuple(a.choices or ()) for a in parser._actions if not a.option_strings
                 and not isinstance(a, argparse._SubParsersAction)), ())  # fmt: skip


def _options(parser):
    """Long options of a command."""
    return [
        option
        for action in parser._actions
        for option in action.option_strings if option.startswith("--")
    ]  # fmt: skip
