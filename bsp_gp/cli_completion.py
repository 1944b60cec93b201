"""Completion of commands and options in a shell, from what the parser knows."""

from __future__ import annotations

import argparse

__all__ = ["completion_script"]

_BASH = """\
_bsp_gp() {{
    local word="${{COMP_WORDS[COMP_CWORD]}}" words
    case "${{COMP_WORDS[1]}}" in
{cases}
        *) words="{commands}" ;;
    esac
    [ "$COMP_CWORD" = 1 ] && words="{commands} --help --version"
    if [ "$COMP_CWORD" = 1 ] || [ "${{word:0:1}}" = - ]; then
        COMPREPLY=($(compgen -W "$words" -- "$word"))
    fi
}}
complete -o default -F _bsp_gp bsp-gp
"""


def completion_script(parser, shell):
    """What a shell reads to complete ``bsp-gp``: bash's own; zsh takes it with bashcompinit.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    shell : {"bash", "zsh"}

    Returns
    -------
    str
    """
    (commands,) = (a.choices for a in parser._actions
                   if isinstance(a, argparse._SubParsersAction))  # fmt: skip
    cases = "\n".join(
        f'        {name}) words="{" ".join(_options(each))}" ;;' for name, each in commands.items()
    )
    head = "autoload -U +X bashcompinit && bashcompinit\n" if shell == "zsh" else ""
    return head + _BASH.format(cases=cases, commands=" ".join(commands))


def _options(parser):
    """Long options of a command that its help shows."""
    return [
        option
        for action in parser._actions if action.help is not argparse.SUPPRESS
        for option in action.option_strings if option.startswith("--")
    ]  # fmt: skip
