// Just what Runtime/Unity uses of UnityEngine, so that it is compiled and run where Unity is not installed.
using System;

namespace UnityEngine
{
    public struct Vector3
    {
        public float x, y, z;

        public Vector3(float x, float y, float z)
        {
            this.x = x;
            this.y = y;
            this.z = z;
        }
    }

    public struct Quaternion
    {
        public float x, y, z, w;

        public Quaternion(float x, float y, float z, float w)
        {
            this.x = x;
            this.y = y;
            this.z = z;
            this.w = w;
        }
    }

    public class Object
    {
        public static implicit operator bool(Object exists) => !ReferenceEquals(exists, null);
    }

    public class Component : Object
    {
        public Transform transform { get; }

        protected Component()
        {
            transform = this as Transform ?? new Transform();
        }
    }

    public class Transform : Component
    {
        public Vector3 localPosition { get; set; }

        public Quaternion localRotation { get; set; } = new Quaternion(0.0f, 0.0f, 0.0f, 1.0f);
    }

    public class MonoBehaviour : Component
    {
    }

    public sealed class GameObject : Object
    {
        public bool activeSelf { get; private set; } = true;

        public void SetActive(bool value) => activeSelf = value;
    }

    public static class Debug
    {
        public static void LogWarning(object message) => Console.Error.WriteLine(message);

        public static void LogException(Exception exception) => Console.Error.WriteLine(exception);
    }

    [AttributeUsage(AttributeTargets.Field)]
    public sealed class TooltipAttribute : Attribute
    {
        public TooltipAttribute(string tooltip)
        {
        }
    }

    [AttributeUsage(AttributeTargets.Class)]
    public sealed class AddComponentMenu : Attribute
    {
        public AddComponentMenu(string menuName)
        {
        }
    }
}
