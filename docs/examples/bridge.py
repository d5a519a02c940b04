"""A bridge in Python, for experiments: it pushes the needle in at 20 mm/s and prints the force. Debian has no Python bindings of LCM, so
this calls liblcm by ctypes; lcm-gen makes the message types.

lcm-gen -p --ppath types /usr/share/trocar/trocar.lcm && python3 bridge.py
"""
import ctypes
import random
import sys
import time

sys.path.insert(0, "types")
from trocar import needle_pose_t, needle_wrench_t

WATCHDOG = 0.02  # s without a wrench until the force is zero


class Received(ctypes.Structure):  # lcm_recv_buf_t
    _fields_ = [("data", ctypes.c_void_p), ("size", ctypes.c_uint32), ("utime", ctypes.c_int64), ("lcm", ctypes.c_void_p)]


liblcm = ctypes.CDLL("liblcm.so.1")
liblcm.lcm_create.restype = liblcm.lcm_subscribe.restype = ctypes.c_void_p
handler = ctypes.CFUNCTYPE(None, ctypes.POINTER(Received), ctypes.c_char_p, ctypes.c_void_p)

session = random.getrandbits(62) | 1  # the first session owns the needle
needle = 0  # its index in the scene
newest, arrival = None, 0.0


@handler
def on_wrench(received, channel, user):
    global newest, arrival
    wrench = needle_wrench_t.decode(ctypes.string_at(received[0].data, received[0].size))
    followed = newest is None or wrench.server == newest.server or time.monotonic() - arrival > 0.1
    if (wrench.session, wrench.needle) == (session, needle) and followed:  # for this device; of two servers the first one
        newest, arrival = wrench, time.monotonic()


lcm = ctypes.c_void_p(liblcm.lcm_create(None))
if not lcm:
    sys.exit("no LCM network: is there a multicast route?")
liblcm.lcm_subscribe(lcm, b"TROCAR_WRENCH", on_wrench, None)
pose = needle_pose_t()
pose.session = session
pose.needle = needle
pose.orientation = [1, 0, 0, 0]
begin = time.monotonic()
while (elapsed := time.monotonic() - begin) < 2:
    pose.seq += 1
    pose.utime = int(1e6 * time.time())
    pose.position = [0.005, 0.003, -0.201 + 0.02 * elapsed]  # your device's
    message = pose.encode()
    liblcm.lcm_publish(lcm, b"TROCAR_POSE", message, len(message))
    liblcm.lcm_handle_timeout(lcm, 1)  # ms
    while liblcm.lcm_handle_timeout(lcm, 0) > 0:
        pass
    alive = newest is not None and time.monotonic() - arrival < WATCHDOG
    force = newest.force if alive else (0, 0, 0)  # to your device
    pose.wrench_tick = newest.tick if alive else 0
    if pose.seq % 200 == 0:
        print("%.2f s: %.3f %.3f %.3f N" % (elapsed, *force), "" if alive else "(no server)")
