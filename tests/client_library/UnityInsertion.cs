// Performs the insertion of insertion.c with the component for Unity at 60 frames per second, using a stand-in for Unity. The scene is displaced and
// rotated by 90 degrees, so that the same needle has a different pose in Unity.
// With SECONDS, the needle is turned, and the program prints its forward and up directions in the scene, computed with the engine's own rotation. Otherwise,
// it also prints what is left of the last wrench when the component is disabled, enabled again, and stopped by a fault.
// usage: UnityInsertion.exe URL [SECONDS [FILE]]
using System;
using System.Diagnostics;
using System.Globalization;
using System.IO;
using System.Reflection;
using System.Threading;
using Trocar;
using UnityEngine;

static class UnityInsertion {
    const double Start = -0.201, Way = 0.021, Speed = 0.01, Frame = 1.0 / 60; // m, m, m/s, s
    static readonly TrocarNeedle needle = new TrocarNeedle();
    static readonly Transform scene = new Transform();
    static readonly object guard = Hidden("guard");
    static readonly TrocarWrench seen = (TrocarWrench)Hidden("seen");
    static TextWriter trace = TextWriter.Null;
    static long frames, answered, outages, back, tick;
    static double most, force;
    static Quaternion turn = Quaternion.identity;

    static double Now() { return (double)Stopwatch.GetTimestamp() / Stopwatch.Frequency; }
    static double Length(Vector3 v) { return Math.Sqrt(v.x * v.x + v.y * v.y + v.z * v.z); }
    static object Hidden(string name) { return typeof(TrocarNeedle).GetField(name, BindingFlags.Instance | BindingFlags.NonPublic).GetValue(needle); }
    static void Call(string name) { typeof(TrocarNeedle).GetMethod(name, BindingFlags.Instance | BindingFlags.NonPublic).Invoke(needle, null); }

    // Places the needle as the engine does. In the scene, the base is at (0.005, 0.003, z): x is mirrored.
    static void Show(double advance) {
        bool wasAnswered = needle.Answered;
        long last = tick;
        Thread.Sleep((int)(1000 * Frame));
        Time.deltaTime = (float)Frame;
        needle.transform.position = scene.position + scene.rotation * new Vector3(-0.005f, 0.003f, (float)(Start + advance));
        needle.transform.rotation = scene.rotation * turn;
        double before = Now();
        lock (guard) {
            Call("Update");
            tick = seen.Tick; // which the component does not publish
        }
        force = Length(needle.Force);
        trace.WriteLine("{0:F7} {1:F7} {2} {3:G9} {4:G9}", before, Now(), tick, force, Length(needle.Torque));
        most = Math.Max(most, force);
        frames++;
        if (needle.Answered) answered++;
        if (wasAnswered && !needle.Answered) outages++;
        if (wasAnswered && needle.Answered && tick < last) back++;
    }

    // Prints how many of the public values are not those of a component without a server.
    static void PrintLeft(string name) {
        bool[] left = { needle.Answered, Length(needle.Force) > 0, Length(needle.Torque) > 0, needle.Depth > 0, needle.Flags != TrocarFlags.None,
                        needle.Events != TrocarEvents.None, needle.Answer != TrocarAnswer.None, needle.Reason != "" };
        Console.WriteLine("{0} {1}", name, Array.FindAll(left, value => value).Length);
    }

    // Disables the component, enables it again, and lets it fail.
    static void Stop() {
        PrintLeft("held");
        Call("OnDisable");
        PrintLeft("disabled");
        Call("OnEnable");
        Show(Way);
        PrintLeft("enabled");
        for (double end = Now() + 10; !needle.Answered && Now() < end;) Show(Way);
        PrintLeft("held_again");
        needle.Ask(client => { throw new InvalidOperationException("a fault for the test"); });
        for (double end = Now() + 10; needle.enabled && Now() < end;) Show(Way);
        PrintLeft("fault");
    }

    static int Main(string[] arguments) {
        Thread.CurrentThread.CurrentCulture = CultureInfo.InvariantCulture;
        scene.position = new Vector3(0.3f, -0.2f, 0.1f);
        scene.rotation = new Quaternion(0, (float)Math.Sqrt(0.5), 0, (float)Math.Sqrt(0.5)); // about y: forward turns to the right
        needle.scene = scene;
        needle.url = arguments[0];
        Call("OnEnable");
        if (arguments.Length == 3) trace = new StreamWriter(arguments[2]);
        if (arguments.Length > 1) {
            turn = new Quaternion(0.5f, -0.1f, 0.5f, 0.7f); // of unit length
            foreach (bool up in new[] { false, true }) {
                Vector3 v = turn * (up ? new Vector3(0, 1, 0) : new Vector3(0, 0, 1));
                Console.WriteLine("{0}_x {1:F6}\n{0}_y {2:F6}\n{0}_z {3:F6}", up ? "up" : "forward", -v.x, v.y, v.z);
            }
            for (double end = Now() + double.Parse(arguments[1]); needle.enabled && Now() < end;) Show(0);
        } else {
            for (double end = Now() + 10; needle.enabled && !needle.Answered && Now() < end;) Show(0);
            int resets = 0;
            do {
                needle.Ask(client => client.Reset());
                do Show(0); while (needle.Answer == TrocarAnswer.Waiting);
                resets++;
            } while (needle.Answer != TrocarAnswer.Done && resets < 5);
            frames = answered = outages = back = 0;
            for (double begin = Now(), t = -0.5; t < 0.5 + Way / Speed; t = Now() - begin - 0.5) Show(t < 0 ? 0 : Math.Min(Way, Speed * t));
            Console.WriteLine("resets {0}", resets);
        }
        Vector3 along = Quaternion.Inverse(scene.rotation) * needle.Force; // in the scene, the tissue pushes back along -z
        Console.WriteLine("periods {0}\nanswered {1}\noutages {2}\nback {3}\nforce {4:F6}\nmost {5:F6}\ndepth {6:F6}\nalong {7:F6}", frames, answered, outages, back,
                          force, most, needle.Depth, along.z);
        trace.Dispose();
        bool failed = !needle.enabled;
        if (arguments.Length == 1) Stop();
        Call("OnDisable");
        return failed ? 1 : 0;
    }
}
