using System;
using System.Text;

namespace Pcmrs
{
    /// <summary>What a datagram of a stream tells.</summary>
    public enum StreamKind
    {
        /// <summary>`crnt_`: the tool in the image, as the tracker measures it, while registered.</summary>
        Tool,

        /// <summary>`trgt_`: the accepted plan, the tool in the image.</summary>
        Target,

        /// <summary>`regi_`: the registration, the image in the patient's reference (body_ref).</summary>
        Registration,

        /// <summary>`__msg_pose_`: the tool in the image, on the link of the visualization.</summary>
        VisualizedTool,

        /// <summary>`__msg_point_`: the tip of the pointer in the image, on the link of the planner.</summary>
        PointerTip,

        /// <summary>`__msg_toolpose_`: two points of a tool pose in the image, relayed to the planner.</summary>
        ToolPoints,
    }

    /// <summary>One datagram of a stream, in Unity's frame and in m, independent of the wire format.</summary>
    public sealed class StreamMessage
    {
        public readonly StreamKind Kind;

        /// <summary>The pose; the identity in a message of points.</summary>
        public readonly RigidPose Pose;

        /// <summary>The points; none in a message of a pose.</summary>
        public readonly Vec3[] Points;

        private const double MetresPerMillimetre = 1e-3;
        private static readonly Vec3[] NoPoints = new Vec3[0];

        private StreamMessage(StreamKind kind, RigidPose pose, Vec3[] points)
        {
            Kind = kind;
            Pose = pose;
            Points = points;
        }

        /// <summary>Reads one datagram of any stream.</summary>
        /// <exception cref="FormatException">It is none, or not whole.</exception>
        public static StreamMessage Parse(byte[] datagram, int length)
        {
            string text = Encoding.ASCII.GetString(datagram, 0, length);
            double[] numbers;
            if (Holds(text, "crnt_", 7, out numbers))
            {
                return OfPose(StreamKind.Tool, AlreadyMirrored(numbers));
            }
            if (Holds(text, "trgt_", 7, out numbers))
            {
                return OfPose(StreamKind.Target, AlreadyMirrored(numbers));
            }
            if (Holds(text, "regi_", 7, out numbers))
            {
                return OfPose(StreamKind.Registration, AlreadyMirrored(numbers));
            }
            if (Holds(text, "__msg_pose_", 7, out numbers))
            {
                var rotation = new Quat(numbers[3], numbers[4], numbers[5], numbers[6]);
                return OfPose(StreamKind.VisualizedTool,
                    new RigidPose(FromMillimetres(numbers, 0), Handedness.Mirror(rotation)));
            }
            if (Holds(text, "__msg_point_", 3, out numbers))
            {
                return OfPoints(StreamKind.PointerTip, FromMillimetres(numbers, 0));
            }
            if (Holds(text, "__msg_toolpose_", 6, out numbers))
            {
                return OfPoints(StreamKind.ToolPoints, FromMillimetres(numbers, 0), FromMillimetres(numbers, 3));
            }
            throw new FormatException("this is no message of a stream");
        }

        /// <summary>Whether a text begins like this; then it has to hold that many numbers.</summary>
        private static bool Holds(string text, string prefix, int count, out double[] numbers)
        {
            numbers = null;
            if (!text.StartsWith(prefix, StringComparison.Ordinal))
            {
                return false;
            }
            numbers = Numbers.Parse(text.Substring(prefix.Length).Split('_'));
            if (numbers.Length != count)
            {
                throw new FormatException(prefix + " has " + numbers.Length + " numbers, not " + count);
            }
            return true;
        }

        /// <summary>The daemon sends the streams of mixed reality in Unity's frame and m.</summary>
        private static RigidPose AlreadyMirrored(double[] n) =>
            new RigidPose(new Vec3(n[0], n[1], n[2]), new Quat(n[3], n[4], n[5], n[6]));

        /// <summary>All other streams are right-handed and in mm.</summary>
        private static Vec3 FromMillimetres(double[] n, int first) =>
            MetresPerMillimetre * Handedness.Mirror(new Vec3(n[first], n[first + 1], n[first + 2]));

        private static StreamMessage OfPose(StreamKind kind, RigidPose pose) =>
            new StreamMessage(kind, pose, NoPoints);

        private static StreamMessage OfPoints(StreamKind kind, params Vec3[] points) =>
            new StreamMessage(kind, RigidPose.Identity, points);
    }
}
