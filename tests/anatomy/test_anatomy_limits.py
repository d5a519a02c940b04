#!/usr/bin/python3
"""Tests stages that never finish or that crash their process."""
import os
import signal
import subprocess
import sys
import time
import unittest
import unittest.mock

from anatomy_cases import SOURCE
from anatomy import limits
from anatomy.shapes import contours

FOREVER = """
import time
from anatomy import limits
limits.end_on_signals()
print("ready", flush=True)
limits.run("forever", time.sleep, 1000)
"""


def running(process):
    try:
        with open(f"/proc/{process}/stat", encoding="ascii") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def refuse():
    raise contours.Unusable("Apex", "too thin", 3.0)


class Large:
    """An object too large to be passed between processes."""

    def __reduce__(self):
        raise MemoryError


class Limits(unittest.TestCase):
    def test_a_result_comes_back(self):
        self.assertEqual(limits.run("sum", sum, [1, 2]), 3)

    def test_what_does_not_end_is_stopped_and_named(self):
        start = time.monotonic()
        with unittest.mock.patch.object(limits, "SECONDS", 0.2), self.assertRaisesRegex(limits.TooLong, "^sleep: not done after 0.2 s"):
            limits.run("sleep", time.sleep, 1000)
        self.assertLess(time.monotonic() - start, 20)

    def test_large_meshes_have_more_time(self):
        self.assertEqual([limits.seconds_for(nodes) for nodes in (570, 10000, 40000)], [120, 120, 480])

    def test_processor_time_counts(self):
        with unittest.mock.patch.object(limits, "SECONDS", 1), self.assertRaisesRegex(limits.TooLong, "^loop: not done after 1 s"):
            limits.run("loop", any, iter(int, 1))

    def test_an_exception_comes_back_as_it_was(self):
        with self.assertRaisesRegex(contours.Unusable, 'region "Apex", slice z = 3 mm: too thin'):
            limits.run("x", refuse)

    def test_a_result_without_memory_to_send_it_is_no_crash(self):
        with self.assertRaises(MemoryError):
            limits.run("x", Large)

    def test_a_crash_is_named(self):
        with self.assertRaisesRegex(limits.Crashed, "^x: ended by signal 6"):
            limits.run("x", os.abort)
        with self.assertRaises(limits.Crashed) as caught:
            limits.run("x", limits.run, "y", os.abort)
        self.assertEqual(caught.exception.number, signal.SIGABRT)      # the outer stage passes the signal number on

    def test_sigterm_ends_the_program_and_its_stage(self):
        program = subprocess.Popen([sys.executable, "-c", FOREVER], stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": os.path.join(SOURCE, "meshes")})
        program.stdout.readline()
        child = None
        for _ in range(200):
            with open(f"/proc/{program.pid}/task/{program.pid}/children", encoding="ascii") as file:
                children = file.read().split()
            if children:
                child = int(children[0])
                break
            time.sleep(0.05)
        program.send_signal(signal.SIGTERM)
        self.assertEqual(program.wait(20), 128 + signal.SIGTERM)
        program.stdout.close()
        for _ in range(200): # the kernel kills the process when the program exits; it is gone once init has reaped it
            if not running(child):
                break
            time.sleep(0.05)
        self.assertFalse(running(child))


if __name__ == "__main__":
    unittest.main()
