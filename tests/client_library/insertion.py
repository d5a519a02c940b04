#!/usr/bin/python3
"""Does what insertion.c does, with the Python client.

usage: insertion.py URL [SECONDS [FILE]]
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
    def __init__(self, client, trace):
        self.client, self.trace, self.wrench = client, trace, trocar_client.Wrench()
        self.force = self.most = 0.0
        self.periods = self.answered = self.outages = self.back = 0

    def exchange(self, advance):
        time.sleep(0.001)
        self.client.publish((0.005, 0.003, START + advance), (1, 0, 0, 0))
        last, before, self.wrench, after = self.wrench, time.monotonic(), self.client.newest(), time.monotonic()
        w, self.force = self.wrench, math.hypot(*self.wrench.force)
        self.trace.write(f"{before} {after} {w.tick} {self.force} {math.hypot(*w.torque)}\n")
        self.periods += 1
        self.answered += w.answered
        self.outages += last.answered and not w.answered
        self.back += w.answered and last.answered and w.tick < last.tick
        self.most = max(self.most, self.force)


def reset(client, felt):
    for times in range(1, 6):
        client.reset()
        while client.reply()[0] is Answer.WAITING:
            felt.exchange(0)
        if client.reply()[0] is Answer.DONE:
            return times
    return 0


def main(url, seconds=None, file=os.devnull):
    with open(file, "w", encoding="ascii") as trace, trocar_client.Client(url) as client:
        before, felt = Felt(client, trace), Felt(client, trace)
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
        for name in ("periods", "answered", "outages", "back", "force", "most"):
            print(name, getattr(felt, name))
        print("depth", felt.wrench.depth)
        print("state", list(trocar_client.State).index(client.state()[0]))


main(*sys.argv[1:])
