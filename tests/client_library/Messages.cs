// Reads messages, each preceded by the letter of its type and its length (2 bytes), decodes them with the C# client, and writes them as encoded again.
// For bytes that do not form exactly one message, it writes only a length of 0.
using System;
using System.IO;
using Trocar;

static class Messages {
    static readonly BigEndianReader from = new BigEndianReader();
    static readonly NeedlePoseMessage pose = new NeedlePoseMessage();
    static readonly CommandMessage command = new CommandMessage();
    static readonly NeedleWrenchMessage wrench = new NeedleWrenchMessage();
    static readonly CommandReplyMessage reply = new CommandReplyMessage();

    static bool Takes(ulong fingerprint, Action<BigEndianReader> decode) {
        if (!from.Begin(fingerprint)) return false;
        decode(from);
        return from.IsWhole;
    }

    static BigEndianWriter Begin(ulong fingerprint) {
        var to = new BigEndianWriter();
        to.UInt64(fingerprint);
        return to;
    }

    static BigEndianWriter Again(int letter) {
        BigEndianWriter to = null;
        switch (letter) {
            case 'p': if (Takes(NeedlePoseMessage.Fingerprint, pose.Decode)) pose.Encode(to = Begin(NeedlePoseMessage.Fingerprint)); break;
            case 'c': if (Takes(CommandMessage.Fingerprint, command.Decode)) command.Encode(to = Begin(CommandMessage.Fingerprint)); break;
            case 'w': if (Takes(NeedleWrenchMessage.Fingerprint, wrench.Decode)) wrench.Encode(to = Begin(NeedleWrenchMessage.Fingerprint)); break;
            case 'r': if (Takes(CommandReplyMessage.Fingerprint, reply.Decode)) reply.Encode(to = Begin(CommandReplyMessage.Fingerprint)); break;
        }
        return to ?? new BigEndianWriter();
    }

    // Invalid options are refused before a socket is opened.
    static void Refuse(TrocarOptions bad) {
        try {
            new TrocarClient(bad).Dispose();
        } catch (ArgumentException) {
            return;
        }
        throw new Exception("impossible options are accepted");
    }

    // A folder in place of the secret file: reading it is refused, even to root.
    static void RefuseSecret() {
        try {
            new TrocarClient(new TrocarOptions { Url = "udp://127.0.0.1:7668", SecretFile = Path.GetTempPath() }).Dispose();
        } catch (InvalidOperationException error) {
            if (error.Message.Contains("secret file " + Path.GetTempPath())) return;
        }
        throw new Exception("no clear message about an unreadable secret");
    }

    static void Main() {
        RefuseSecret();
        Refuse(new TrocarOptions { Needle = -1 });
        Refuse(new TrocarOptions { Watchdog = double.NaN });
        Refuse(new TrocarOptions { MaxForce = -1 });
        var input = new BinaryReader(new BufferedStream(Console.OpenStandardInput()));
        using (var output = new BinaryWriter(new BufferedStream(Console.OpenStandardOutput()))) {
            for (int letter; (letter = input.BaseStream.ReadByte()) >= 0;) {
                byte[] bytes = input.ReadBytes(input.ReadUInt16());
                from.Set(bytes, 0, bytes.Length);
                BigEndianWriter again = Again(letter);
                output.Write((ushort)again.Size);
                output.Write(again.Bytes, 0, again.Size);
            }
        }
    }
}
