namespace Pcmrs
{
    /// <summary>
    /// The mirror between the right-handed frames of PCMRS and Unity's left-handed ones: it swaps y and z.
    ///
    /// RAS (x right, y anterior, z superior) becomes Unity's x right, y up, z forward, so that a patient who stands in
    /// the image stands upright in the scene. Every frame is mirrored alike, also those of robot, tracker and tool:
    /// with S the swap, a transform T becomes S T S, and products stay products. The mirror is its own inverse.
    /// </summary>
    public static class Handedness
    {
        public static Vec3 Mirror(Vec3 v) => new Vec3(v.X, v.Z, v.Y);

        /// <summary>The axis is mirrored, and a mirrored rotation turns the other way.</summary>
        public static Quat Mirror(Quat q) => new Quat(-q.X, -q.Z, -q.Y, q.W);

        public static RigidPose Mirror(RigidPose pose) =>
            new RigidPose(Mirror(pose.Position), Mirror(pose.Rotation));

        /// <summary>A homogeneous matrix (row, column): rows 1 and 2 change places, and so do columns 1 and 2.</summary>
        public static double[,] Mirror(double[,] matrix)
        {
            int[] swapped = { 0, 2, 1, 3 };
            var mirrored = new double[4, 4];
            for (int row = 0; row < 4; row++)
            {
                for (int column = 0; column < 4; column++)
                {
                    mirrored[row, column] = matrix[swapped[row], swapped[column]];
                }
            }
            return mirrored;
        }
    }
}
