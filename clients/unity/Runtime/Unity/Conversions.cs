using UnityEngine;

namespace Pcmrs.Unity
{
    /// <summary>
    /// Between the types of Core and those of UnityEngine. Both are in Unity's frame and m already: nothing is mirrored.
    /// </summary>
    public static class Conversions
    {
        public static Vector3 ToVector3(this Vec3 v) => new Vector3((float)v.X, (float)v.Y, (float)v.Z);

        public static Quaternion ToQuaternion(this Quat q) =>
            new Quaternion((float)q.X, (float)q.Y, (float)q.Z, (float)q.W);

        public static Vec3 ToVec3(this Vector3 v) => new Vec3(v.x, v.y, v.z);

        public static Quat ToQuat(this Quaternion q) => new Quat(q.x, q.y, q.z, q.w);

        /// <summary>Where an object is in its parent, such as a planned tool below the image.</summary>
        public static RigidPose LocalPose(this Transform transform) =>
            new RigidPose(transform.localPosition.ToVec3(), transform.localRotation.ToQuat());

        /// <summary>Puts an object where the pose says, in its parent.</summary>
        public static void SetLocalPose(this Transform transform, RigidPose pose)
        {
            transform.localPosition = pose.Position.ToVector3();
            transform.localRotation = pose.Rotation.ToQuaternion();
        }
    }
}
