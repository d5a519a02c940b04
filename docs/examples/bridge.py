"""A bridge in Python, for experiments: it pushes the needle in at 20 mm/s and prints the force.

cp /usr/share/trocar/client/trocar_client.py . && python3 bridge.py
"""
import time

import trocar_client

with trocar_client.Client() as server:
    begin = time.monotonic()
    while (elapsed := time.monotonic() - begin) < 2:
        time.sleep(0.001)
        server.publish((0.005, 0.003, -0.201 + 0.02 * elapsed), (1, 0, 0, 0))  # your device's position (m) and orientation (w x y z)
        wrench = server.newest()
        if wrench.tick % 200 == 0:
            print("%.2f s: %.3f %.3f %.3f N" % (elapsed, *wrench.force), "" if wrench.answered else "(no server)")  # to your device
