// Like insertion.c, but with the client in C#.
// usage: Insertion.exe URL [SECONDS [FILE]]
using System;
using System.Diagnostics;
using System.Globalization;
using System.IO;
using System.Threading;
using Trocar;

static class Insertion {
    const double Start = -0.201, Way = 0.021, Speed = 0.01; // m, m, m/s
    static readonly double[] position = { 0.005, 0.003, Start }, orientation = { 1, 0, 0, 0 };
    static readonly TrocarWrench wrench = new TrocarWrench();
    static TextWriter trace = TextWriter.Null;

    static double Now() { return (double)Stopwatch.GetTimestamp() / Stopwatch.Frequency; }
    static double Length(double[] a) { return Math.Sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]); }

    sealed class Felt {
        internal double Force, Most;
        internal long Periods, Answered, Outages, Back, Tick;
        internal bool WasAnswered;
    }

    static void Exchange(TrocarClient client, double advance, Felt f) {
        Thread.Sleep(1);
        position[2] = Start + advance;
        client.Publish(position, orientation);
        double before = Now();
        bool answered = client.Newest(wrench);
        double after = Now(), force = Length(wrench.Force);
        trace.WriteLine("{0:F7} {1:F7} {2} {3:G12} {4:G12}", before, after, wrench.Tick, force, Length(wrench.Torque));
        f.Periods++;
        if (answered) f.Answered++;
        if (f.WasAnswered && !answered) f.Outages++;
        if (answered && f.WasAnswered && wrench.Tick < f.Tick) f.Back++;
        f.Most = Math.Max(f.Most, force);
        f.Force = force;
        f.Tick = wrench.Tick;
        f.WasAnswered = answered;
    }

    static int Reset(TrocarClient client, Felt f) {
        for (int times = 1; times <= 5; times++) {
            client.Reset();
            while (client.Reply() == TrocarAnswer.Waiting) Exchange(client, 0, f);
            if (client.Reply() == TrocarAnswer.Done) return times;
        }
        return 0;
    }

    static int Main(string[] arguments) {
        CultureInfo.DefaultThreadCurrentCulture = CultureInfo.InvariantCulture;
        Thread.CurrentThread.CurrentCulture = CultureInfo.InvariantCulture;
        Felt before = new Felt(), f = new Felt();
        if (arguments.Length == 3) trace = new StreamWriter(arguments[2]);
        try {
            using (trace)
            using (var client = new TrocarClient(new TrocarOptions { Url = arguments[0] })) {
                if (arguments.Length > 1) {
                    for (double end = Now() + double.Parse(arguments[1]); Now() < end;) Exchange(client, 0, f);
                } else {
                    for (double end = Now() + 10; !before.WasAnswered && Now() < end;) Exchange(client, 0, before);
                    Console.WriteLine("resets {0}", Reset(client, before));
                    for (double begin = Now(), t = -0.5; t < 0.5 + Way / Speed; t = Now() - begin - 0.5)
                        Exchange(client, t < 0 ? 0 : Math.Min(Way, Speed * t), f);
                }
                Console.WriteLine("periods {0}\nanswered {1}\noutages {2}\nback {3}", f.Periods, f.Answered, f.Outages, f.Back);
                string reason;
                Console.WriteLine("force {0:F6}\nmost {1:F6}\ndepth {2:F6}\nstate {3}", f.Force, f.Most, wrench.Depth, (int)client.State(out reason));
            }
        } catch (InvalidOperationException error) {
            Console.Error.WriteLine(error.Message);
            return 1;
        }
        return 0;
    }
}
