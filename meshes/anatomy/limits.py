"""Runs each stage of the work in its own process, so that it can be stopped: a call into a library cannot be interrupted otherwise."""
import ctypes
import math
import multiprocessing
import os
import resource
import signal
import sys
import time
import traceback

DEFAULT = 120.0         # s, limit on the CPU time of each stage; unlike elapsed time, it does not depend on other load on the machine
NODES = 10000           # the default limit applies up to this many nodes
SECONDS = DEFAULT       # s, current limit
WAITING = 10            # the limit on elapsed time is this many times the limit on CPU time, to catch a stage that hangs
TELL = False            # true to print the name of each stage
BEGUN = time.monotonic()
FEW = 6                 # maximum number of names listed in a message
WITH_PARENT = 1         # prctl's PR_SET_PDEATHSIG


class TooLong(Exception):
    """Raised if a stage exceeds its time limit."""


class NoMemory(MemoryError):
    """Raised if the machine does not have enough memory for a stage."""


class Crashed(Exception):
    """Raised if a library crashed the stage's process, or raised an exception that cannot be sent to the parent. number: the signal that killed the process,
    or None."""

    def __init__(self, text, number=None):
        super().__init__(text)
        self.number = number


def seconds_for(nodes):
    """Returns the default time limit for a mesh with this many nodes."""
    return DEFAULT * max(1.0, nodes / NODES)


def run(stage, work, *arguments):
    """Runs work(*arguments) in a child process and returns its result. stage: what to call it in messages."""
    if TELL:
        print(f"anatomy: {time.monotonic() - BEGUN:.0f} s: {stage}", file=sys.stderr, flush=True)
    receiver, sender = multiprocessing.Pipe(duplex=False)
    context = multiprocessing.get_context("fork")    # a forked process inherits the arguments, however large they are
    child = context.Process(target=serve, args=(sender, work, arguments))    # not daemonic, because it may run stages of its own
    child.start()
    sender.close()
    try:
        if not receiver.poll(WAITING * SECONDS):
            raise too_long(stage)
        result, error, place = receiver.recv()
    except EOFError:
        child.join()
        if child.exitcode == -signal.SIGXCPU:
            raise too_long(stage) from None
        if child.exitcode < 0:
            raise Crashed(f"{stage}: ended by signal {-child.exitcode}", -child.exitcode) from None
        raise Crashed(f"{stage}: ended without a result") from None
    finally:
        child.kill()
        child.join()
        receiver.close()
    if isinstance(error, MemoryError) and not isinstance(error, NoMemory):
        raise NoMemory(f"{stage}: this machine's memory does not suffice: choose fewer regions or nodes, or a smaller part of the image") from error
    if error:
        error.place = place     # the child's traceback, for debugging
        raise error
    return result


def few(names):
    """Formats names for a message."""
    names = list(names)
    return ", ".join(names[:FEW]) + (f" and {len(names) - FEW} more" if len(names) > FEW else "")


def too_long(stage):
    return TooLong(f"{stage}: not done after {SECONDS:g} s, stopped: raise --time-limit, or choose fewer regions or nodes")


def serve(sender, work, arguments):
    """Runs in the child process: sends the result, or the exception and its traceback."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    ctypes.CDLL(None).prctl(WITH_PARENT, signal.SIGKILL)
    most, hard = math.ceil(SECONDS), resource.getrlimit(resource.RLIMIT_CPU)[1]
    resource.setrlimit(resource.RLIMIT_CPU, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)       # some libraries write their progress to stdout
    os.dup2(quiet, 2)
    try:
        answer = work(*arguments), None, None
    except Exception as error:  # pass any exception on; the parent decides what to do with it
        answer = None, error, traceback.format_exc()
    try:
        sender.send(answer)
    except MemoryError as error:
        sender.send((None, error, answer[2]))
    except Exception as error:  # the library's exception may not be picklable
        sender.send((None, Crashed(f"{error}: {answer[2]}"), answer[2]))


def end_on_signals():
    """Makes SIGTERM end the program and its child, like Ctrl-C."""
    def stop(number, _):
        raise SystemExit(128 + number)
    signal.signal(signal.SIGTERM, stop)
