"""The command line: parses, calls, reports. Exit codes: 0 ok, 1 bad input, 2 some frames failed or are wrong, 3 internal error."""

from __future__ import annotations

import errno
import os
import shlex
import sys
import traceback
from typing import Annotated

import typer
from typer.completion import completion_init

from . import speech
from .align.command import align
from .avatar.command import animate, edit, train
from .config.command import settings
from .console import COMPLETE, GivenOnce, completion, spoken
from .errors import UserError, first_line
from .io.command import body_model, export, import_capture
from .kernels import InputError
from .measure.command import doctor, evaluate, inspect, report
from .pipeline.commands.pictures import detect, reconstruct
from .pipeline.commands.register import register
from .pipeline.commands.standing import plan, status, template
from .pipeline.commands.tune import tune
from .pipeline.stopping import raise_when_terminated
from .studio.command import studio
from .view.command import view

app = typer.Typer(  # without markup: it would take the units in brackets for styles
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help=__doc__,
    context_settings={"help_option_names": ["-h", "--help"]},
)
LINE = 1000  # characters of a message that are shown
STOPPED = 130
RESUMED = ("register", "reconstruct", "align", "train", "studio")  # the same command goes on with what was stopped


def say_version(asked: bool):
    if asked:
        from . import __version__

        typer.echo(f"toile {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def begin(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", help="say the version and end", is_eager=True, callback=say_version)
    ] = False,
):
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(1)


NAMES = {import_capture: "import", body_model: "body-model"}
COMMANDS = (
    *(plan, detect, reconstruct, register, evaluate, report, template),
    *(align, train, animate, edit, studio, inspect, tune, status, view, import_capture, export, body_model),
)  # in the order in which `toile -h` lists them
for command in COMMANDS:
    app.command(NAMES.get(command), cls=GivenOnce)(spoken(command))
for command in (settings, doctor, completion):  # they log nothing
    app.command(cls=GivenOnce)(command)


def main():
    """Entry point with the exit codes of this page."""
    speech.speak()
    raise_when_terminated()
    if COMPLETE in os.environ:
        completion_init()
    try:
        code = app(standalone_mode=False, prog_name="toile", complete_var=COMPLETE)
        if code == STOPPED:  # typer's answer to Ctrl-C
            raise KeyboardInterrupt
    except (UserError, InputError) as error:
        code = told(str(error), 1)
    except (typer.Abort, KeyboardInterrupt):
        code = told(f"stopped; go on with: {resumed()}" if resumed() else "stopped", STOPPED)
    except (OSError, MemoryError) as error:  # a full disk, a folder that may not be written
        full = getattr(error, "errno", None) in (errno.ENOSPC, errno.EDQUOT) and resumed()
        code = told(first_line(error) + (f"; once there is space, go on with: {resumed()}" if full else ""), 1)
    except Exception as error:
        if hasattr(error, "exit_code") and hasattr(error, "format_message"):  # of the command line's own parser
            command = getattr(error.ctx, "command_path", "toile")
            code = told(f"{error.format_message().rstrip('.')} (see {command} -h)", 1)
        else:
            traceback.print_exc()
            message = f"internal error: {type(error).__name__}: {error}"
            code = told(f"{message}; please report it, with what `toile doctor` says", 3)
    sys.exit(code or 0)


def resumed():
    """This command line, where the same again goes on with what was stopped; "" elsewhere."""
    return f"toile {shlex.join(sys.argv[1:])}" if sys.argv[1:] and sys.argv[1] in RESUMED else ""


def told(message, code):
    """The exit code, once the message stands on one line of stderr."""
    if speech.manner.verbose and code == 1:
        traceback.print_exc()
    speech.error(" ".join(message.split())[:LINE], code, "--json" in sys.argv)  # also where the parser never came to it
    return code
