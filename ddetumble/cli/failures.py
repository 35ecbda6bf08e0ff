"""Whatever goes wrong becomes one sentence on standard error and an exit code; nobody sees a traceback."""

import errno
import io
import os
import shlex
import sys
import tempfile
import threading
import traceback
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from .._errors import ComputationError, InputError
from .interrupts import INTERRUPTED, was_interrupted


BAD_INPUT, FAILED, PIPE_CLOSED = 2, 1, 141  # exit codes: of typer's own refusals, of Python's, 128 and SIGPIPE
_stopped = threading.Event()


def run_guarded(action: Callable[[], object], words: Sequence[str] = ()) -> int:
    """Run a command and turn each way of failing into a sentence and an exit code.

    Args:
        action: The command; an integer that it returns is its exit code.
        words: The command line, for the report of an unforeseen error.

    Returns:
        0 on success, 2 on bad input, 1 on a failed computation (or a page that could not be drawn beside results that
        are kept), 130 if interrupted, 141 if nobody reads the output.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # not so under a test runner
            stream.reconfigure(errors="replace")
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_, **__: print(f"ddetumble: note: {_join(str(message))}",
                                                               file=sys.stderr)
        try:
            code = action()
            sys.stdout.flush()
            if code == INTERRUPTED:  # typer's answer to an interrupt
                raise KeyboardInterrupt
            return code if isinstance(code, int) else 0
        except KeyboardInterrupt:
            return tell_stopped()
        except BrokenPipeError:
            return _leave_pipe()
        except SystemExit as error:  # typer's answer to a closed pipe
            if isinstance(error.__context__, BrokenPipeError):
                return _leave_pipe()
            raise
        except Exception as error:
            if was_interrupted():
                return tell_stopped()
            # What Windows raises in place of a broken pipe.
            if (sys.platform == "win32" and isinstance(error, OSError) and error.errno == errno.EINVAL
                    and error.filename is None):
                return _leave_pipe()
            return tell(*explain(error, words))


def tell(sentence: str, code: int) -> int:
    """Print a sentence to standard error and hand the exit code on."""
    with suppress(OSError):  # nobody is listening; the exit code says the rest
        print(f"ddetumble: {sentence}", file=sys.stderr, flush=True)
    return code


def tell_stopped() -> int:
    """Print, once for each process that ends by it, that the command was stopped; returns the exit code."""
    if threading.current_thread() is threading.main_thread():
        _stopped.set()
    elif _stopped.is_set():
        return INTERRUPTED
    return tell("stopped.", INTERRUPTED)


def explain(error: Any, words: Sequence[str]) -> tuple[str, int]:
    """Sentence and exit code for an exception; of an unforeseen one the traceback is kept in a file."""
    if isinstance(error, InputError):
        return str(error), BAD_INPUT
    if isinstance(error, ComputationError):
        return _join(str(error)), FAILED
    if hasattr(error, "format_message"):  # typer's own, about the command line
        message = _join(error.format_message()).rstrip(".")
        context = getattr(error, "ctx", None)
        command = context.command_path if context is not None else "ddetumble"
        end = "" if message.endswith("?") else ";"
        return (f"{message[:1].lower()}{message[1:]}{end} `{command} --help` shows the arguments, with an example.",
                BAD_INPUT)
    if isinstance(error, MemoryError):
        return "there is not enough memory for this.", FAILED
    if isinstance(error, OSError) and error.filename is not None:
        reason = (error.strerror or "it cannot be used").lower()
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        return _join(f"{error.filename}: {reason}."), FAILED if full else BAD_INPUT
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        return "there is no space left on the disk.", FAILED
    return _report_bug(error, words), FAILED


def _report_bug(error: Exception, words: Sequence[str]) -> str:
    """Write the traceback of an unforeseen error to a file; returns the sentence that says so."""
    text = f"ddetumble {shlex.join(words)}\nPython {sys.version}\n\n" + "".join(traceback.format_exception(error))
    try:
        handle, path = tempfile.mkstemp(prefix="ddetumble-", suffix=".log")
        with open(handle, "w", encoding="utf-8", errors="backslashreplace") as stream:
            stream.write(text)
        where = f"the traceback is in {path}"
    except OSError:
        where = "its traceback could not be written anywhere"
    reason = _join(f"{type(error).__name__}: {error}")
    reason = reason if len(reason) <= 200 else reason[:197] + "..."
    return f"this is a bug in ddetumble, not in your input ({reason}), and {where}."


def _leave_pipe() -> int:
    """Go quietly when the reader of a pipe has left, and keep Python from complaining at exit."""
    with suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return PIPE_CLOSED


def _join(text: str) -> str:
    """Put text on one line."""
    return " ".join(text.split())
