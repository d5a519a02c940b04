#!/usr/bin/python3
"""Does what insertion.c does, with the Python client.

usage: insertion.py URL [SECONDS]
"""
import math
import os
import sys
import time

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../clients/python"))
sys.dont_write_bytecode = True
import trocar_client
from trocar_client import Answer

START, WAY, SPEED = -0.201, 0.021, 0.01    # m, m, m/s


class Felt:
    def __init__(self, client):
        self.client, self.wrench = client, trocar_client.Wrench()
        self.force = self.most = self.step = 0.0
        self.periods = self.answered = self.outages = self.back = 0

    def exchange(self, advance):
        time.sleep(0.001)
        self.client.publish((0.005, 0.003, START + advance), (1, 0, 0, 0))
        before, self.wrench = self.wrench, self.client.newest()
        w, last, self.force = self.wrench, self.force, math.hypot(*self.wrench.force)
        both = w.answered and before.answered
        self.periods += 1
        self.answered += w.answered
        self.outages += before.answered and not w.answered
        self.back += both and w.tick < before.tick
        self.step = max(self.step, abs(self.force - last)) if both else self.step
        self.most = max(self.most, self.force)


def reset(client, felt):
    for times in range(1, 6):
        client.reset()
        while client.reply()[0] is Answer.WAITING:
            felt.exchange(0)
        if client.reply()[0] is Answer.DONE:
            return times
    return 0


def main(url, seconds=None):
    with trocar_client.Client(url) as client:
        before, felt = Felt(client), Felt(client)
        if seconds:
            end = time.monotonic() + float(seconds)
            while time.monotonic() < end:
                felt.exchange(0)
        else:
            end = time.monotonic() + 10
            while not before.wrench.answered and time.monotonic() < end:
                before.exchange(0)
            print("resets", reset(client, before))
            begin, t = time.monotonic(), -0.5
            while t < 0.5 + WAY / SPEED:
                felt.exchange(min(WAY, max(0.0, SPEED * t)))
                t = time.monotonic() - begin - 0.5
        for name in ("periods", "answered", "outages", "back", "force", "most", "step"):
            print(name, getattr(felt, name))
        print("depth", felt.wrench.depth)


main(*sys.argv[1:])
