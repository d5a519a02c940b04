#!/usr/bin/python3
"""Sends packets to LCM's default group that no LCM library would send: first all crafted packets on every channel, then fuzzed fragments.

usage: crafted_packets.py SECONDS     (in a private network namespace: scripts/netns)
"""
import random
import socket
import struct
import sys
import time

CHANNELS = [b"TROCAR_" + name for name in (b"POSE", b"COMMAND", b"WRENCH", b"TIMING", b"STATUS", b"REPLY", b"CONTACTS", b"DEFORMATION")]
NUMBERS = [0, 1, 2, 19, 20, 64, 500, 1000, 65487, 1 << 20, 1 << 24, 1 << 28, (1 << 32) - 256, (1 << 32) - 20, (1 << 32) - 1]


def fragment(seq, size, offset, number, count, rest):
    return struct.pack(">4sIIIHH", b"LC03", seq, size, offset, number, count) + rest


def crafted(channel):
    """Yields packets that can each crash an unprotected receiver, whether or not it subscribes to the channel."""
    name = channel + b"\0"
    begin = fragment(1, 1000, 0, 0, 2, name + b"\1" * 400)
    yield fragment(1, 1000, 2**32 - 256, 0, 2, name + b"\1" * 400)          # offset + length overflows
    yield begin
    yield fragment(1, 1000, 2**32 - 4096, 1, 2, b"\1" * 5000)               # offset + length overflows in a later fragment
    yield begin
    yield fragment(1, 1000, 400, 1, 2, b"")[:12]                            # shorter than a fragment header
    yield fragment(1, 1000, 0, 0, 1, channel)                               # channel name not terminated
    yield fragment(1, 2**28, 0, 0, 2, name + b"\1" * 400)                   # 256 MB
    yield fragment(1, 1000, 0, 0, 0, name + b"\1" * 400)                    # zero fragments
    yield fragment(1, 1000, 0, 0, 1, name + b"\1" * 40)                     # a single fragment with most of its data missing
    yield begin
    yield begin
    yield b"LC02\0\0\0\1" + channel                                         # channel name not terminated
    yield b"LC02\0\0\0\1" + b"x" * 60000
    yield b"LC02"
    yield b""


def fuzzed(rng):
    number = rng.choice(NUMBERS + [rng.getrandbits(32)])
    name = rng.choice([rng.choice(CHANNELS) + b"\0", rng.choice(CHANNELS), b""])
    packet = fragment(rng.randrange(3), number, rng.choice(NUMBERS + [rng.getrandbits(32)]), rng.randrange(3), rng.randrange(4),
                      name + rng.randbytes(rng.choice([0, 1, 40, 500, 1000, 5000])))
    return packet if rng.random() < 0.9 else packet[:rng.randrange(len(packet))]


def main():
    rng = random.Random(1)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    to = ("239.255.76.67", 7667)
    for channel in CHANNELS:
        for packet in crafted(channel):
            sender.sendto(packet, to)
            time.sleep(0.002)
    count, end = 0, time.monotonic() + float(sys.argv[1])
    while time.monotonic() < end:
        sender.sendto(fuzzed(rng), to)
        count += 1
        if count % 20 == 0:
            time.sleep(0.001)
    print(f"{count} fuzzed fragments")


main()
