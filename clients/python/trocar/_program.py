"""What the command-line programs share: progress display, option types and exit statuses."""
from __future__ import annotations

import argparse
import re
import signal
import sys
import time
from typing import Any, Callable


FAILED = 3    # exit status if something outside the program failed: a missing package, memory, or a file that cannot be read or written


class Progress:
    """Progress display: a bar on a terminal, otherwise a line at the start, at every tenth of the work, and at the end."""

    WIDTH = 30

    def __init__(self, quiet: bool, program: str, things: str):
        self.program, self.things = program, things
        self.quiet, self.bar = quiet, sys.stderr.isatty()
        self.start, self.first, self.shown, self.tenth = time.monotonic(), None, 0.0, -1

    def __call__(self, done: int, of: int) -> None:
        now = time.monotonic()
        self.first = done if self.first is None else self.first
        if self.quiet or of == 0:
            return
        rate = (done - self.first) / max(now - self.start, 1e-9)
        words = f"{done} of {of} {self.things}" + (f", {rate:.1f} a second, {(of - done) / rate:.0f} s left" if done > self.first and done < of else "")
        if self.bar and (now - self.shown > 0.1 or done == of):
            full = self.WIDTH * done // of
            print(f"\r[{'#' * full}{' ' * (self.WIDTH - full)}] {words}\033[K", end="\n" if done == of else "", file=sys.stderr, flush=True)
            self.shown = now
        elif not self.bar and 10 * done // of > self.tenth:
            print(f"{self.program}: {words}", file=sys.stderr, flush=True)
            self.tenth = 10 * done // of


def whole_number(text: str) -> int:
    if not re.fullmatch(r"[1-9]\d{0,5}", text):
        raise argparse.ArgumentTypeError(f"{text}: write a whole number from 1")
    return int(text)


def say(program: str, words: str) -> None:
    print(f"{program}: {words}", file=sys.stderr)


def _stop(number: int, _: Any) -> None:
    raise SystemExit(128 + number)


def ended(program: str, call: Callable[[], int], place: str, packages: str, interrupted: str = "interrupted") -> int:
    """Calls `call()` and returns its exit status. An interrupt, a missing Python module or a file that cannot be read or written is reported in one line
    instead of a traceback; the last two give the exit status FAILED. `packages`: the Debian packages to install if a module is missing; `place`: the file to
    name if the error doesn't. SIGTERM ends the call like an exception."""
    signal.signal(signal.SIGTERM, _stop)
    try:
        return call()
    except ImportError as error:
        say(program, f"{error}: apt install {packages}")
        return FAILED
    except KeyboardInterrupt:
        say(program, interrupted)
        return 130
    except OSError as error:
        say(program, f"{error.filename2 or error.filename or place}: {error.strerror or error}")
        return FAILED
