// SPDX-License-Identifier: MIT
// SPDX-FileCopyrightText: 2026 trocar developers
//
// A needle in Unity. Add this file and TrocarClient.cs to your project, and put the component on the object that shows the needle. The object's
// pose is that of the needle's base; its blue axis (forward) is the needle's axis, and the bevel faces its green axis (up). One unit is one metre.
//
// trocar-server's scene is right-handed and Unity is left-handed, so x is mirrored.
using System;
using System.Threading;
using UnityEngine;

namespace Trocar {

[AddComponentMenu("Trocar/Needle")]
public sealed class TrocarNeedle : MonoBehaviour {
    [Tooltip("The origin of trocar's scene; none: Unity's")]
    public Transform scene;
    [Tooltip("LCM's address, or udp://HOST:PORT of a server with --listen; empty: LCM's default")]
    public string url = "";
    [Tooltip("File with the secret of a server with --listen; empty: $TROCAR_SECRET_FILE, or no secret")]
    public string secretFile = "";
    [Tooltip("Index of the needle in the scene, from 0")]
    public int needle;
    [Tooltip("On for a mouse, a controller or a tracker: the needle follows rigidly. Off where Force is rendered")]
    public bool withoutForce = true;
    [Tooltip("N")]
    public double maxForce = 20;

    // While the component is disabled, all values below are false, zero or empty.

    /// <summary>True while wrenches arrive from a server.</summary>
    public bool Answered { get; private set; }
    /// <summary>N, in Unity's frame: force exerted on the hand by the needle's base.</summary>
    public Vector3 Force { get; private set; }
    /// <summary>N m, in Unity's frame: torque about the base point.</summary>
    public Vector3 Torque { get; private set; }
    /// <summary>m, length of the needle's track in the tissue.</summary>
    public double Depth { get; private set; }
    public TrocarFlags Flags { get; private set; }
    /// <summary>Events of the wrenches received since this component's last update.</summary>
    public TrocarEvents Events { get; private set; }
    /// <summary>Result of the last command. If it is not Done, Reason says why.</summary>
    public TrocarAnswer Answer { get; private set; }
    public string Reason { get; private set; }

    // The server ramps the force to zero if no pose arrives for more than 10 ms, so a thread sends poses at about 1 kHz. It interpolates them between
    // frames, which makes the needle lag the object by one frame.
    readonly object guard = new object(); // protects the members below
    readonly double[] from = new double[7], to = new double[7];
    double begin, duration; // s
    readonly TrocarWrench seen = new TrocarWrench();
    TrocarEvents seenEvents;
    bool seenAnswer, placed, ends;
    Func<TrocarClient, bool> command;
    TrocarAnswer seenReply;
    string seenReason = "", fault;
    Thread thread;

    /// <summary>Queues a command, such as <c>Ask(client => client.Reset())</c>. Answer holds the result. Returns false if the previous
    /// command has not been sent yet.</summary>
    public bool Ask(Func<TrocarClient, bool> given) {
        lock (guard) {
            if (command != null) return false;
            command = given;
            seenReply = TrocarAnswer.Waiting;
        }
        return true;
    }

    void OnEnable() {
        ends = false;
        Forget();
        fault = null;
        var options = new TrocarOptions { Url = url, SecretFile = secretFile, Needle = needle, WithoutForce = withoutForce, MaxForce = maxForce };
        thread = new Thread(() => Exchange(options)) { IsBackground = true, Name = "trocar needle" };
        thread.Start();
    }

    void OnDisable() {
        lock (guard) ends = true;
        thread.Join(); // a few ms; while the client is still connecting, up to ten seconds over multicast, and two over unicast once the host's name is known
        Show();
    }

    // Drops what the thread has received: once it has ended, nothing renews the last wrench.
    void Forget() {
        placed = false;
        command = null;
        seen.Clear();
        seenEvents = TrocarEvents.None;
        seenAnswer = false;
        seenReply = TrocarAnswer.None;
        seenReason = "";
    }

    // Copies what the thread has received to the public properties.
    void Show() {
        Answered = seenAnswer;
        Force = Out(seen.Force, -1, 1, 1);
        Torque = Out(seen.Torque, 1, -1, -1);
        Depth = seen.Depth;
        Flags = seen.Flags;
        Events = seenEvents;
        Answer = seenReply;
        Reason = seenReason;
        seenEvents = TrocarEvents.None;
    }

    void Update() {
        string broken;
        lock (guard) {
            double now = Clock.Now();
            if (placed) Interpolate(now, from);
            Read(to);
            if (!placed) Array.Copy(to, from, 7);
            begin = now;
            duration = Time.deltaTime;
            placed = true;
            Show();
            broken = fault;
        }
        if (broken == null) return;
        Debug.LogError(broken, this);
        enabled = false;
    }

    // Reads the object's pose in the scene's frame. Mirroring x also reverses rotations about y and z.
    void Read(double[] pose) {
        Vector3 p = scene == null ? transform.position : scene.InverseTransformPoint(transform.position);
        Quaternion q = scene == null ? transform.rotation : Quaternion.Inverse(scene.rotation) * transform.rotation;
        pose[0] = -p.x;
        pose[1] = p.y;
        pose[2] = p.z;
        pose[3] = q.w;
        pose[4] = q.x;
        pose[5] = -q.y;
        pose[6] = -q.z;
    }

    Vector3 Out(double[] vector, float x, float y, float z) {
        var own = new Vector3(x * (float)vector[0], y * (float)vector[1], z * (float)vector[2]);
        return scene == null ? own : scene.rotation * own;
    }

    // Interpolates between the poses of the last two frames and normalizes the quaternion.
    void Interpolate(double now, double[] pose) {
        double part = duration > 0 ? Math.Min(1, (now - begin) / duration) : 1, product = 0, norm = 0;
        for (int i = 3; i < 7; i++) product += from[i] * to[i];
        for (int i = 0; i < 7; i++) {
            double sign = i >= 3 && product < 0 ? -1 : 1; // q and -q are the same rotation
            pose[i] = (1 - part) * from[i] + part * sign * to[i];
            if (i >= 3) norm += pose[i] * pose[i];
        }
        for (int i = 3; i < 7; i++) pose[i] /= Math.Sqrt(norm);
    }

    // Main function of the thread: sends poses and receives wrenches until the component is disabled.
    void Exchange(TrocarOptions options) {
        double[] pose = new double[7], position = new double[3], orientation = new double[4];
        var wrench = new TrocarWrench();
        string broken = null;
        try {
            using (var client = new TrocarClient(options)) {
                for (;;) {
                    Func<TrocarClient, bool> asked;
                    Thread.Sleep(1);
                    lock (guard) {
                        if (ends) return;
                        if (!placed) continue;
                        Interpolate(Clock.Now(), pose);
                        asked = command;
                    }
                    bool given = asked != null && asked(client);
                    Array.Copy(pose, position, 3);
                    Array.Copy(pose, 3, orientation, 0, 4);
                    client.Publish(position, orientation);
                    bool answered = client.Newest(wrench);
                    string reason;
                    TrocarAnswer reply = client.Reply(out reason);
                    lock (guard) {
                        if (given) command = null;
                        if (command == null) seenReply = reply;
                        seenReason = reason;
                        seenAnswer = answered;
                        seenEvents |= wrench.Events;
                        wrench.CopyTo(seen);
                    }
                }
            }
        } catch (Exception error) {
            broken = error.Message;
        } finally {
            lock (guard) {
                Forget();
                fault = broken;
            }
        }
    }
}

}
