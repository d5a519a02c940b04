/* Sends trocar-server's messages with values chosen by the test, and receives the messages sent to it. */
#ifndef TROCAR_TESTS_SLICER_FAKE_SERVER_H
#define TROCAR_TESTS_SLICER_FAKE_SERVER_H

#include <algorithm>
#include <array>
#include <atomic>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

#include <lcm/lcm.h>

#include "expect.h"
extern "C" {
#include "trocar_command_t.h"
#include "trocar_contacts_t.h"
#include "trocar_deformation_t.h"
#include "trocar_needle_pose_t.h"
#include "trocar_needle_wrench_t.h"
#include "trocar_probe_pose_t.h"
#include "trocar_probe_wrench_t.h"
#include "trocar_status_t.h"
}

using Vector = std::array<double, 3>;

class FakeServer {
public:
    /* Set these members before calling start(). `displace` returns the displacement (m) of a node at a time (s). */
    std::vector<Vector> nodes, centreline;
    std::function<Vector(const Vector &, double)> displace = [](const Vector &, double) { return Vector{0, 0, 0}; };
    double orientation[4] = {1, 0, 0, 0}, tip_lead = 0;
    Vector force{}, probe{}, probe_force{};
    double probe_orientation[4] = {1, 0, 0, 0};
    std::atomic<int64_t> number{77};
    std::atomic<bool> silent{false};
    std::atomic<size_t> most_nodes{SIZE_MAX}; /* most nodes in its messages */

    FakeServer() {
        hearing = lcm_create(nullptr);
        on_pose = trocar_needle_pose_t_subscribe(hearing, "TROCAR_POSE", [](const lcm_recv_buf_t *, const char *, const trocar_needle_pose_t *m, void *c) {
            auto *s = static_cast<FakeServer *>(c);
            std::lock_guard<std::mutex> lock(s->mutex);
            s->heard_poses.push_back(*m);
            s->owner = m->session;
        }, this);
        on_probe = trocar_probe_pose_t_subscribe(hearing, "TROCAR_PROBE", [](const lcm_recv_buf_t *, const char *, const trocar_probe_pose_t *m, void *c) {
            auto *s = static_cast<FakeServer *>(c);
            std::lock_guard<std::mutex> lock(s->mutex);
            s->heard_probes.push_back(*m);
        }, this);
        on_command = trocar_command_t_subscribe(hearing, "TROCAR_COMMAND", [](const lcm_recv_buf_t *, const char *, const trocar_command_t *m, void *c) {
            auto *s = static_cast<FakeServer *>(c);
            if (m->command == TROCAR_COMMAND_T_RELEASE) s->releases++;
        }, this);
    }
    void start() {
        threads.emplace_back([this] {
            while (!ends) lcm_handle_timeout(hearing, 20);
        });
        threads.emplace_back([this] { send(); });
    }
    ~FakeServer() {
        ends = true;
        for (std::thread &t : threads) t.join();
        trocar_needle_pose_t_unsubscribe(hearing, on_pose);
        trocar_probe_pose_t_unsubscribe(hearing, on_probe);
        trocar_command_t_unsubscribe(hearing, on_command);
        lcm_destroy(hearing);
    }
    std::vector<trocar_needle_pose_t> poses() { /* returns the poses received since the last call */
        std::lock_guard<std::mutex> lock(mutex);
        return std::move(heard_poses);
    }
    std::vector<trocar_probe_pose_t> probes() {
        std::lock_guard<std::mutex> lock(mutex);
        return std::move(heard_probes);
    }
    std::atomic<int> releases{0};

private:
    static int64_t now() { return std::llround(1e6 * epoch_seconds()); }

    void send_picture(lcm_t *lcm) {
        size_t count = std::min<size_t>(nodes.size(), most_nodes);
        std::vector<std::array<float, 3>> moved(count);
        std::vector<float *> rows(count);
        for (size_t i = 0; i < count; i++) {
            Vector u = displace(nodes[i], seconds());
            for (int a = 0; a < 3; a++) moved[i][a] = static_cast<float>(u[a]);
            rows[i] = moved[i].data();
        }
        std::vector<double *> joints;
        for (Vector &joint : centreline) joints.push_back(joint.data());
        trocar_contacts_t c = {};
        c.utime = now(), c.server = number, c.tick = tick, c.tip_lead = tip_lead;
        std::copy(orientation, orientation + 4, c.orientation);
        c.joint_count = static_cast<int32_t>(joints.size()), c.centreline = joints.data();
        if (!joints.empty()) trocar_contacts_t_publish(lcm, "TROCAR_CONTACTS", &c);
        trocar_deformation_t d = {};
        d.utime = now(), d.server = number, d.tick = tick, d.node_count = static_cast<int32_t>(rows.size()), d.displacement = rows.data();
        trocar_deformation_t_publish(lcm, "TROCAR_DEFORMATION", &d);
        trocar_probe_wrench_t p = {};
        p.utime = now(), p.server = number, p.tick = tick;
        std::copy(probe.begin(), probe.end(), p.position);
        std::copy(probe_force.begin(), probe_force.end(), p.force);
        std::copy(probe_orientation, probe_orientation + 4, p.orientation);
        trocar_probe_wrench_t_publish(lcm, "TROCAR_PROBE_WRENCH", &p);
    }

    void send_wrench(lcm_t *lcm) {
        trocar_needle_wrench_t w = {};
        w.utime = now(), w.server = number, w.tick = tick, w.session = owner, w.membrane = -1, w.depth = 0.0125;
        std::copy(force.begin(), force.end(), w.force);
        trocar_needle_wrench_t_publish(lcm, "TROCAR_WRENCH", &w);
    }

    void send_status(lcm_t *lcm) {
        char empty[] = "", scene[] = "/scenes/a \"b\".yaml";
        trocar_status_t s = {};
        s.utime = now(), s.server = number, s.needle_count = 1, s.host = empty, s.scene = scene, s.inverse = empty, s.message = empty;
        trocar_status_t_publish(lcm, "TROCAR_STATUS", &s);
    }

    /* Sends a wrench every 2 ms, a frame (contacts, deformation, probe) every 33.3 ms and the status every 0.1 s. */
    void send() {
        lcm_t *lcm = lcm_create(nullptr);
        double picture = seconds(), status = picture, wrench = picture;
        for (; !ends; tick++, wrench += 0.002, wait(wrench - seconds())) {
            if (silent) continue;
            send_wrench(lcm);
            if (seconds() >= picture) send_picture(lcm), picture += 1.0 / 30;
            if (seconds() >= status) send_status(lcm), status += 0.1;
        }
        lcm_destroy(lcm);
    }

    lcm_t *hearing;
    trocar_needle_pose_t_subscription_t *on_pose;
    trocar_probe_pose_t_subscription_t *on_probe;
    trocar_command_t_subscription_t *on_command;
    std::atomic<bool> ends{false};
    std::atomic<int64_t> tick{1}, owner{0};
    std::mutex mutex;
    std::vector<trocar_needle_pose_t> heard_poses;
    std::vector<trocar_probe_pose_t> heard_probes;
    std::vector<std::thread> threads;
};

#endif
