using System;

namespace Pcmrs
{
    /// <summary>A point or a translation, m.</summary>
    public struct Vec3
    {
        public readonly double X, Y, Z;

        public Vec3(double x, double y, double z)
        {
            X = x;
            Y = y;
            Z = z;
        }

        public double Norm => Math.Sqrt(X * X + Y * Y + Z * Z);

        public static Vec3 operator +(Vec3 a, Vec3 b) => new Vec3(a.X + b.X, a.Y + b.Y, a.Z + b.Z);

        public static Vec3 operator -(Vec3 a) => new Vec3(-a.X, -a.Y, -a.Z);

        public static Vec3 operator *(double factor, Vec3 a) => new Vec3(factor * a.X, factor * a.Y, factor * a.Z);
    }

    /// <summary>A rotation as a unit quaternion; its algebra is the same in left-handed and right-handed frames.</summary>
    public struct Quat
    {
        public readonly double X, Y, Z, W;

        /// <summary>Normalizes what it is given, so that rounding on the wire does not scale what is rotated.</summary>
        /// <exception cref="FormatException">It is far from a unit quaternion.</exception>
        public Quat(double x, double y, double z, double w)
        {
            double norm = Math.Sqrt(x * x + y * y + z * z + w * w);
            if (!(Math.Abs(norm - 1.0) < Tolerance))
            {
                throw new FormatException("a quaternion has length " + norm + ", not 1");
            }
            X = x / norm;
            Y = y / norm;
            Z = z / norm;
            W = w / norm;
        }

        private const double Tolerance = 1e-2;

        public static Quat Identity => new Quat(0.0, 0.0, 0.0, 1.0);

        public Quat Inverse => new Quat(-X, -Y, -Z, W);

        /// <summary>First b, then a.</summary>
        public static Quat operator *(Quat a, Quat b) => new Quat(
            a.W * b.X + a.X * b.W + a.Y * b.Z - a.Z * b.Y,
            a.W * b.Y - a.X * b.Z + a.Y * b.W + a.Z * b.X,
            a.W * b.Z + a.X * b.Y - a.Y * b.X + a.Z * b.W,
            a.W * b.W - a.X * b.X - a.Y * b.Y - a.Z * b.Z);

        public static Vec3 operator *(Quat q, Vec3 v)
        {
            double tx = 2.0 * (q.Y * v.Z - q.Z * v.Y);
            double ty = 2.0 * (q.Z * v.X - q.X * v.Z);
            double tz = 2.0 * (q.X * v.Y - q.Y * v.X);
            return new Vec3(
                v.X + q.W * tx + q.Y * tz - q.Z * ty,
                v.Y + q.W * ty + q.Z * tx - q.X * tz,
                v.Z + q.W * tz + q.X * ty - q.Y * tx);
        }

        /// <summary>From the upper left 3 x 3 of a matrix (row, column).</summary>
        /// <exception cref="FormatException">It is no rotation: mirrored, scaled or not finite.</exception>
        public static Quat FromMatrix(double[,] m)
        {
            CheckRotation(m);
            double trace = m[0, 0] + m[1, 1] + m[2, 2];
            if (trace > 0.0)
            {
                double s = 2.0 * Math.Sqrt(1.0 + trace);
                return new Quat((m[2, 1] - m[1, 2]) / s, (m[0, 2] - m[2, 0]) / s, (m[1, 0] - m[0, 1]) / s, s / 4.0);
            }
            // Of the axes the one with the largest component, so that nothing is divided by a number near 0.
            int i = m[0, 0] >= m[1, 1] && m[0, 0] >= m[2, 2] ? 0 : m[1, 1] >= m[2, 2] ? 1 : 2;
            int j = (i + 1) % 3, k = (i + 2) % 3;
            double root = 2.0 * Math.Sqrt(1.0 + m[i, i] - m[j, j] - m[k, k]);
            var axis = new double[3];
            axis[i] = root / 4.0;
            axis[j] = (m[i, j] + m[j, i]) / root;
            axis[k] = (m[i, k] + m[k, i]) / root;
            return new Quat(axis[0], axis[1], axis[2], (m[k, j] - m[j, k]) / root);
        }

        private static void CheckRotation(double[,] m)
        {
            for (int i = 0; i < 3; i++)
            {
                int j = (i + 1) % 3, k = (i + 2) % 3;
                for (int column = 0; column < 3; column++)
                {
                    // In a rotation, and in no mirrored one, each row is the cross product of the two others.
                    int next = (column + 1) % 3, last = (column + 2) % 3;
                    double cross = m[j, next] * m[k, last] - m[j, last] * m[k, next];
                    if (!(Math.Abs(m[i, column] - cross) < Tolerance))
                    {
                        throw new FormatException("a matrix is no rotation");
                    }
                }
            }
        }
    }

    /// <summary>A rigid transform `a_from_b`: where frame b is in frame a, position in m.</summary>
    public struct RigidPose
    {
        public readonly Vec3 Position;
        public readonly Quat Rotation;

        public RigidPose(Vec3 position, Quat rotation)
        {
            Position = position;
            Rotation = rotation;
        }

        public static RigidPose Identity => new RigidPose(new Vec3(), Quat.Identity);

        public RigidPose Inverse => new RigidPose(-(Rotation.Inverse * Position), Rotation.Inverse);

        /// <summary>`a_from_b * b_from_c` is `a_from_c`.</summary>
        public static RigidPose operator *(RigidPose a, RigidPose b) =>
            new RigidPose(a.Position + a.Rotation * b.Position, a.Rotation * b.Rotation);

        /// <summary>`a_from_b * point_b` is `point_a`.</summary>
        public static Vec3 operator *(RigidPose a, Vec3 point) => a.Position + a.Rotation * point;

        /// <summary>The homogeneous matrix (row, column), translation in m.</summary>
        public double[,] ToMatrix()
        {
            Vec3 x = Rotation * new Vec3(1.0, 0.0, 0.0);
            Vec3 y = Rotation * new Vec3(0.0, 1.0, 0.0);
            Vec3 z = Rotation * new Vec3(0.0, 0.0, 1.0);
            return new[,]
            {
                { x.X, y.X, z.X, Position.X },
                { x.Y, y.Y, z.Y, Position.Y },
                { x.Z, y.Z, z.Z, Position.Z },
                { 0.0, 0.0, 0.0, 1.0 },
            };
        }

        /// <summary>From a homogeneous matrix (row, column), translation in m.</summary>
        /// <exception cref="FormatException">It is no rigid transform.</exception>
        public static RigidPose FromMatrix(double[,] m) =>
            new RigidPose(new Vec3(m[0, 3], m[1, 3], m[2, 3]), Quat.FromMatrix(m));
    }
}
