#!/usr/bin/python3
"""Simulates a bad network between two LCM groups: datagrams sent to one group arrive in the other, but some are lost, duplicated, or overtaken by others.
Prints `ready`; on SIGTERM, prints the counts as JSON and exits.

usage: lossy_link.py GROUP:PORT GROUP:PORT LOSS TWICE DELAY    LOSS, TWICE: fractions of the datagrams; DELAY: largest delay, s; each datagram has a random
delay
"""
import heapq
import json
import random
import select
import signal
import socket
import struct
import sys
import time


def listener(group, port):
    s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    s.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    s.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
    s.bind((group, port))
    s.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + struct.pack("=I", socket.INADDR_ANY))
    s.setblocking(False)
    return s


def main():
    groups = [(group, int(port)) for group, port in (given.split(":") for given in sys.argv[1:3])]
    loss, twice, delay = map(float, sys.argv[3:])
    rng = random.Random(1)
    listeners = {listener(*group): (groups[1 - i], i) for i, group in enumerate(groups)}
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender.bind(("", 0))
    own = sender.getsockname()[1]
    done = {"passed": [0, 0], "lost": [0, 0], "twice": [0, 0], "overtaken": [0, 0]}
    queue, count, newest, ends = [], 0, [0, 0], []
    signal.signal(signal.SIGTERM, lambda *_: ends.append(True))
    print("ready", flush=True)
    while not ends:
        wait = max(0.0, queue[0][0] - time.monotonic()) if queue else 0.05
        for s in select.select(listeners, [], [], wait)[0]:
            to, way = listeners[s]
            for _ in range(100):
                try:
                    packet, (_, port) = s.recvfrom(65536)
                except BlockingIOError:
                    break
                if port == own:     # sent by this program, in the other direction
                    continue
                if rng.random() < loss:
                    done["lost"][way] += 1
                    continue
                copies = 1 + (rng.random() < twice)
                done["twice"][way] += copies - 1
                for _ in range(copies):
                    count += 1
                    heapq.heappush(queue, (time.monotonic() + delay * rng.random(), count, packet, to, way))
        now = time.monotonic()
        while queue and queue[0][0] <= now:
            _, number, packet, to, way = heapq.heappop(queue)
            done["overtaken"][way] += number < newest[way]
            newest[way] = max(newest[way], number)
            sender.sendto(packet, to)
            done["passed"][way] += 1
    print(json.dumps(done))


main()
