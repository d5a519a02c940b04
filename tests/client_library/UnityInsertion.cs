// Performs the insertion of insertion.c with the component for Unity at 60 frames per second, using a stand-in for Unity. The scene is displaced and
// rotated by 90 degrees, so that the same needle has a different pose in Unity.
// With SECONDS, the needle is turned, and the program prints its forward and up directions in the scene, computed with the engine's own rotation.
// usage: UnityInsertion.exe URL [SECONDS]
using System;
using System.Diagnostics;
using System.Globalization;
using System.Reflection;
using System.Threading;
using Trocar;
using UnityEngine;

static class UnityInsertion {
    const double Start = -0.201, Way = 0.021, Speed = 0.01, Frame = 1.0 / 60; // m, m, m/s, s
    static readonly TrocarNeedle needle = new TrocarNeedle();
    static readonly Transform scene = new Transform();
    static long frames, answered, outages;
    static double most, force;
    static Quaternion turn = Quaternion.identity;

    static double Now() { return (double)Stopwatch.GetTimestamp() / Stopwatch.Frequency; }
    static void Call(string name) { typeof(TrocarNeedle).GetMethod(name, BindingFlags.Instance | BindingFlags.NonPublic).Invoke(needle, null); }

    // Places the needle as the engine does. In the scene, the base is at (0.005, 0.003, z): x is mirrored.
    static void Show(double advance) {
        bool before = needle.Answered;
        Thread.Sleep((int)(1000 * Frame));
        Time.deltaTime = (float)Frame;
        needle.transform.position = scene.position + scene.rotation * new Vector3(-0.005f, 0.003f, (float)(Start + advance));
        needle.transform.rotation = scene.rotation * turn;
        Call("Update");
        Vector3 f = needle.Force;
        force = Math.Sqrt(f.x * f.x + f.y * f.y + f.z * f.z);
        most = Math.Max(most, force);
        frames++;
        if (needle.Answered) answered++;
        else if (before) outages++;
    }

    static int Main(string[] arguments) {
        Thread.CurrentThread.CurrentCulture = CultureInfo.InvariantCulture;
        scene.position = new Vector3(0.3f, -0.2f, 0.1f);
        scene.rotation = new Quaternion(0, (float)Math.Sqrt(0.5), 0, (float)Math.Sqrt(0.5)); // about y: forward turns to the right
        needle.scene = scene;
        needle.url = arguments[0];
        Call("OnEnable");
        if (arguments.Length == 2) {
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
            frames = answered = outages = 0;
            for (double begin = Now(), t = -0.5; t < 0.5 + Way / Speed; t = Now() - begin - 0.5) Show(t < 0 ? 0 : Math.Min(Way, Speed * t));
            Console.WriteLine("resets {0}", resets);
        }
        Vector3 along = Quaternion.Inverse(scene.rotation) * needle.Force; // in the scene, the tissue pushes back along -z
        Console.WriteLine("periods {0}\nanswered {1}\noutages {2}\nback 0\nforce {3:F6}\nmost {4:F6}\nstep 0\ndepth {5:F6}\nalong {6:F6}", frames, answered, outages,
                          force, most, needle.Depth, along.z);
        Call("OnDisable");
        return needle.enabled ? 0 : 1;
    }
}
