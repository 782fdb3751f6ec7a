"""The command line: `cosserat-jax scenes`, `solve`, `sweep`, `actuate`, `fit` and `reach`.

Exit status: 0; 1 if a rod has no solution; 2 for bad input, with one line on stderr; 130 if stopped from the keyboard.
"""

import contextlib
import os
import sys
from collections.abc import Sequence
from typing import Any

import click

from ..errors import InputError, OutputError, nearest
from .actuate import actuate_command
from .common import Command, Stopped, no_cache_option, say
from .fit import fit_command
from .process import stoppable
from .reach import reach_command
from .solve import solve_command
from .sweep import sweep_command


class _Commands(click.Group):
    """click's group, with Ctrl-C as one line and a hint for a command that does not exist."""

    command_class = Command

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple:
        if args[0] not in self.commands and not args[0].startswith("-"):
            ctx.fail(f"no such command {args[0]!r}; {nearest(args[0], list(self.commands))}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise Stopped("stopped") from None


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command, `argv` or the shell's words after `cosserat-jax`, and returns its exit status."""
    try:
        with stoppable() if argv is None else contextlib.nullcontext():
            return _commands.main(argv, prog_name="cosserat-jax", standalone_mode=False) or 0
    except Stopped as stop:
        if sys.stderr.isatty():
            click.echo(err=True)  # ends the line of the progress bar or of ^C
        say(stop.message)
        if argv is None:
            os._exit(stop.exit_code)  # JAX, stopped while it compiles, can crash in its own clean-up at exit
        return stop.exit_code
    except click.UsageError as error:
        command = error.ctx.command_path if error.ctx else "cosserat-jax"
        return _failed(f"{error.format_message()} (see '{command} --help')")
    except (InputError, OutputError, click.ClickException) as error:
        return _failed(str(error))
    except OSError as error:
        return _failed(f"{error.filename or 'a file'}: {error.strerror or error}")


def _failed(message: str) -> int:
    say(f"error: {message}")
    return 2


@click.group(
    cls=_Commands,
    params=[no_cache_option],
    context_settings={"help_option_names": ["-h", "--help"]},
    no_args_is_help=False,
)
@click.version_option(package_name="cosserat_jax", prog_name="cosserat-jax")
def _commands() -> None:
    """Statics of soft rods that bend under muscles and water.

    SCENE is a TOML file or the name of a preset. A parameter is named by its path, such as water.velocity or
    muscles.0.tension, and a value is a number with a unit, or in SI without one.

    \b
    Examples:
      cosserat-jax scenes
      cosserat-jax solve octopus --set "muscles.0.tension=15 N"
      cosserat-jax sweep octopus --out octopus.nc --plot octopus.png
      cosserat-jax actuate octopus-tcam --until "6.5 s" --plot octopus.gif
      cosserat-jax fit octopus tips.csv --free arm.youngs_modulus
      cosserat-jax reach two-segments --target "35, 5 cm" --free muscles.0.tension muscles.1.tension muscles.2.tension
    """


@_commands.command("scenes")
def _scenes() -> None:
    """List the scenes that ship with the package.

    \b
    Example:
      cosserat-jax scenes
    """
    from ..scene import presets, read

    width = max(len(name) for name in presets())
    for name in presets():
        click.echo(f"{name:{width}}  {read(name).title}")


for _command in (solve_command, sweep_command, actuate_command, fit_command, reach_command):
    _commands.add_command(_command)
