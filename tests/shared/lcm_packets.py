"""Receives LCM packets without liblcm, and waits for conditions that depend on them."""
import socket
import time


def lcm_socket():
    """Returns a socket that receives the packets on LCM's default network."""
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
    receiver.bind(("239.255.76.67", 7667))
    receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton("239.255.76.67") + socket.inet_aton("127.0.0.1"))
    return receiver


def message_of(packet):
    """Returns a packet's channel and its data without the type's fingerprint, or (b"", b"") if it is a fragment of a message."""
    if packet[:4] != b"LC02":
        return b"", b""
    channel = packet[8:].split(b"\0")[0]
    return channel, packet[8 + len(channel) + 1 + 8:]


def wait(condition, what, patience=15):
    """Waits until the condition holds. After `patience` (s), fails with `what`, a text or a function that returns one."""
    end = time.monotonic() + patience
    while not condition():
        if time.monotonic() > end:
            raise AssertionError(what() if callable(what) else what)
        time.sleep(0.005)
