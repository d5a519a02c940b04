// The parts of Unity that clients/client/TrocarNeedle.cs uses, as Unity's documentation describes them, so that it can be compiled and run without
// Unity. As in Unity, the frame is left-handed: x right, y up, z forward.
using System;

namespace UnityEngine {

public struct Vector3 {
    public float x, y, z;
    public Vector3(float x, float y, float z) { this.x = x; this.y = y; this.z = z; }
    public static Vector3 operator +(Vector3 a, Vector3 b) { return new Vector3(a.x + b.x, a.y + b.y, a.z + b.z); }
    public static Vector3 operator -(Vector3 a, Vector3 b) { return new Vector3(a.x - b.x, a.y - b.y, a.z - b.z); }
    public static Vector3 Cross(Vector3 a, Vector3 b) { return new Vector3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x); }
}

public struct Quaternion {
    public float x, y, z, w;
    public Quaternion(float x, float y, float z, float w) { this.x = x; this.y = y; this.z = z; this.w = w; }
    public static Quaternion identity { get { return new Quaternion(0, 0, 0, 1); } }
    public static Quaternion Inverse(Quaternion q) { return new Quaternion(-q.x, -q.y, -q.z, q.w); }

    public static Quaternion operator *(Quaternion a, Quaternion b) {
        return new Quaternion(a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y, a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
                              a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w, a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z);
    }

    public static Vector3 operator *(Quaternion q, Vector3 v) {
        Quaternion r = q * new Quaternion(v.x, v.y, v.z, 0) * Inverse(q);
        return new Vector3(r.x, r.y, r.z);
    }
}

public sealed class Transform {
    public Vector3 position;
    public Quaternion rotation = Quaternion.identity;
    public Vector3 InverseTransformPoint(Vector3 point) { return Quaternion.Inverse(rotation) * (point - position); }
}

public class MonoBehaviour {
    public bool enabled = true;
    public readonly Transform transform = new Transform();
}

public static class Time {
    public static float deltaTime;
}

public static class Debug {
    public static void LogError(object message, object context) { Console.Error.WriteLine(message); }
}

public sealed class TooltipAttribute : Attribute {
    public TooltipAttribute(string text) { }
}

public sealed class AddComponentMenu : Attribute {
    public AddComponentMenu(string name) { }
}

}
