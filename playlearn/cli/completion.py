"""`playlearn completion`: commands, options, their choices and the fields of configs, for bash and zsh."""

import argparse
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from playlearn.cli.verb import DONE, Verb

SHELLS = ("bash", "zsh")


@dataclass(frozen=True)
class Command:
    """What may follow a command. options: those of its own and its config's fields. values: option -> its choices."""

    help: str
    options: tuple[str, ...]
    values: Mapping[str, tuple[str, ...]]
    words: tuple[str, ...]


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shell", choices=SHELLS)
    parser.epilog = (
        "bash: `playlearn completion bash > ~/.local/share/bash-completion/completions/playlearn`; "
        "zsh: `playlearn completion zsh > DIR/_playlearn`, DIR being one of $fpath. Then start a new shell."
    )


def run(arguments: argparse.Namespace) -> int:
    commands = {verb.name: _command(verb, parser._actions) for verb, parser in arguments.parsers.items()}
    print(_bash(commands) if arguments.shell == "bash" else _zsh(commands), end="")
    return DONE


def _command(verb: Verb, actions: Sequence[argparse.Action]) -> Command:
    own = [option for action in actions for option in action.option_strings]
    values = {
        option: tuple(map(str, action.choices))
        for action in actions
        if action.choices is not None
        for option in action.option_strings
    }
    words = tuple(str(word) for action in actions if not action.option_strings for word in action.choices or ())
    fields = _fields(verb.config)
    values = {option: choices for option, choices in fields.items() if choices} | values
    return Command(verb.help, tuple(dict.fromkeys((*own, *fields))), values, words)


def _fields(name: str) -> dict[str, tuple[str, ...]]:
    """What `--field value` can set in a config, and the choices where there are few."""
    from playlearn.api.configs import CONFIGS
    from playlearn.cli.config import load
    from playlearn.config.reference import field_choices

    found = next((field_choices(load(known)) for known in CONFIGS if known == name), {})
    return {f"--{field}": choices for field, choices in found.items()}


def _bash(commands: Mapping[str, Command]) -> str:
    cases = "\n".join(f"    {name}) words={_quoted(_after(one))} ;;" for name, one in commands.items())
    values = "\n".join(
        f"    '{name} {option}') words={_quoted(choices)} ;;"
        for name, one in commands.items()
        for option, choices in one.values.items()
    )
    return f"""\
# bash completion for playlearn; written by `playlearn completion bash`
_playlearn() {{
  local current=${{COMP_WORDS[COMP_CWORD]}} before=${{COMP_WORDS[COMP_CWORD-1]}} words=
  COMPREPLY=()
  if [ "$COMP_CWORD" -eq 1 ]; then
    COMPREPLY=($(compgen -W {_quoted((*commands, "--help", "--version"))} -- "$current"))
    return
  fi
  case "${{COMP_WORDS[1]}} $before" in
{values}
  esac
  if [ -z "$words" ] && {{ [ "${{current#-}}" != "$current" ] || [ "$COMP_CWORD" -eq 2 ]; }}; then
    case "${{COMP_WORDS[1]}}" in
{cases}
    esac
  fi
  COMPREPLY=($(compgen -W "$words" -- "$current"))
}}
complete -o default -F _playlearn playlearn
"""


def _zsh(commands: Mapping[str, Command]) -> str:
    names = "\n".join(f"    {shlex.quote(f'{name}:{one.help.replace(":", "")}')}" for name, one in commands.items())
    cases = "\n".join(
        f"    {name}) words_=({' '.join(map(shlex.quote, _after(one)))}) ;;" for name, one in commands.items()
    )
    values = "\n".join(
        f"    '{name} {option}') compadd -- {' '.join(map(shlex.quote, choices))}; return ;;"
        for name, one in commands.items()
        for option, choices in one.values.items()
    )
    return f"""\
#compdef playlearn
# zsh completion for playlearn; written by `playlearn completion zsh`
_playlearn() {{
  local -a commands words_
  commands=(
{names}
  )
  if (( CURRENT == 2 )); then
    _describe command commands
    return
  fi
  case "$words[2] $words[CURRENT-1]" in
{values}
  esac
  case "$words[2]" in
{cases}
  esac
  if [[ $PREFIX == -* ]] || (( CURRENT == 3 )); then
    compadd -- $words_
  fi
  [[ $PREFIX == -* ]] || _files
}}
if [[ $zsh_eval_context[-1] == loadautofunc ]]; then
  _playlearn "$@"
else
  compdef _playlearn playlearn
fi
"""


def _after(command: Command) -> tuple[str, ...]:
    """What may come after a command: its first word, its options."""
    return (*command.words, *command.options)


def _quoted(words: Iterable[str]) -> str:
    return shlex.quote(" ".join(words))


VERB = Verb("completion", "print a script that completes playlearn's commands in bash or zsh", run, add)
