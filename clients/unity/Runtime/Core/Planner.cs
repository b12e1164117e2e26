using System;
using System.Collections.Generic;
using System.Globalization;
using System.Threading.Tasks;

namespace Pcmrs
{
    /// <summary>What the tracker measured at the target.</summary>
    public struct MeasuredPlacement
    {
        /// <summary>The tool in the image.</summary>
        public RigidPose Pose;

        public double TranslationErrorMm, RotationErrorDeg;
    }

    /// <summary>
    /// The commands of a procedure. Poses and points are in Unity's frame and m, and become the image's here.
    /// Each task ends with a <see cref="CommandRefusedException"/> where the daemon does not accept the command.
    /// </summary>
    public sealed class Planner
    {
        private static readonly TimeSpan Soon = TimeSpan.FromSeconds(10.0);
        private static readonly TimeSpan Connecting = TimeSpan.FromSeconds(30.0);
        private static readonly TimeSpan Touching = TimeSpan.FromSeconds(90.0);
        private static readonly TimeSpan Moving = TimeSpan.FromSeconds(240.0);
        private static readonly TimeSpan TouchingAll = TimeSpan.FromSeconds(600.0);

        private readonly CommandLink link;

        public Planner(CommandLink link)
        {
            this.link = link;
        }

        /// <summary>Plans landmarks at points of the image.</summary>
        public async Task PlanLandmarksAsync(IReadOnlyList<Vec3> points)
        {
            await Demand("img_fid_numxxxxx", Soon, points.Count).ConfigureAwait(false);
            for (int index = 0; index < points.Count; index++)
            {
                Vec3 p = Handedness.Mirror(points[index]);
                await Demand("img_fid_pntxxxxx", Soon, index, p.X, p.Y, p.Z).ConfigureAwait(false);
            }
            await Demand("img_fid_lastrecv", Soon).ConfigureAwait(false);
        }

        /// <summary>Has all landmarks touched in order.</summary>
        public Task DigitizeAllAsync() => Demand("start_autodigitz", TouchingAll);

        /// <summary>Has one landmark touched; they count from 0.</summary>
        public Task DigitizeAsync(int index) => Demand("img_dig_digitize", Touching, index);

        /// <summary>Registers; the mean residual in mm.</summary>
        public async Task<double> RegisterAsync() =>
            (await Demand("start_registrati", Soon).ConfigureAwait(false)).Results[0];

        /// <summary>Plans the pose of the tool in the image.</summary>
        public async Task PlanPoseAsync(RigidPose pose)
        {
            RigidPose t = Handedness.Mirror(pose);
            Quat q = t.Rotation;
            await Demand("target_rotxxxxxx", Soon, q.X, q.Y, q.Z, q.W).ConfigureAwait(false);
            await Demand("target_tslxxxxxx", Soon, t.Position.X, t.Position.Y, t.Position.Z).ConfigureAwait(false);
        }

        public Task ConnectAsync() => Demand("rob_conn_onxxxxx", Connecting);

        public Task DisconnectAsync() => Demand("rob_conn_offxxxx", Connecting);

        /// <summary>Moves to the standoff of the planned pose.</summary>
        public Task ApproachAsync() => Demand("execute_motionxx", Moving);

        /// <summary>Advances to the planned pose.</summary>
        public async Task<MeasuredPlacement> ConfirmAsync()
        {
            double[] results = (await Demand("execute_confirmx", Moving).ConfigureAwait(false)).Results;
            return new MeasuredPlacement
            {
                Pose = FromWire(results), TranslationErrorMm = results[7], RotationErrorDeg = results[8],
            };
        }

        /// <summary>Moves along the axes of the tool.</summary>
        public Task NudgeAsync(Vec3 translation)
        {
            Vec3 t = Handedness.Mirror(translation);
            return Demand("adjust_tranxxxxx", Moving, t.X, t.Y, t.Z);
        }

        /// <summary>
        /// Turns about the axes of the tool. The daemon adds up the angles about z, y and x of all turns since the
        /// approach: turns about several axes, one after the other, are not their product.
        /// </summary>
        public Task NudgeAsync(Quat rotation)
        {
            double[,] m = new RigidPose(new Vec3(), Handedness.Mirror(rotation)).ToMatrix();
            double z = Math.Atan2(m[1, 0], m[0, 0]);
            double y = Math.Asin(Math.Max(-1.0, Math.Min(1.0, -m[2, 0])));
            double x = Math.Atan2(m[2, 1], m[2, 2]);
            return Demand("adjust_oriexxxxx", Moving, z, y, x);
        }

        /// <summary>Withdraws along the tool's axis.</summary>
        public Task BackOffAsync() => Demand("execute_bkoffset", Moving);

        public Task HomeAsync() => Demand("execute_homexxxx", Moving);

        /// <summary>Restarts the procedure: no landmarks, no registration, no planned pose.</summary>
        public Task ReinitiateAsync() => Demand("session_reinitxx", Soon);

        /// <summary>The measured joints, rad.</summary>
        public async Task<double[]> JointsAsync() =>
            (await Demand("get_jnt_angsxxxx", Soon).ConfigureAwait(false)).Results;

        /// <summary>The flange in the robot's base, of the measured joints.</summary>
        public async Task<RigidPose> FlangeAsync() =>
            FromWire((await Demand("get_eff_posexxxx", Soon).ConfigureAwait(false)).Results);

        /// <summary>Begins the streams of poses; target and registration are sent once more.</summary>
        public Task StartPosesAsync() => Demand("start_visualizex", Soon);

        public Task StopPosesAsync() => Demand("stop_visualizexx", Soon);

        /// <summary>Begins the stream of the pointer's tip, which goes to the planner's stream port.</summary>
        public Task StartTipAsync() => Demand("tre_startcalcuxx", Soon);

        public Task StopTipAsync() => Demand("tre_stopcalcuxxx", Soon);

        /// <summary>
        /// Shows the planner two points of a tool pose in the image. It is no command: nothing answers. From another
        /// machine the daemon takes it of a peer that may plan a tool pose.
        /// </summary>
        public void SendToolPoints(Vec3 first, Vec3 second) =>
            link.SendMessage("__msg_toolpose_" + InMillimetres(first) + "_" + InMillimetres(second));

        /// <summary>Stops every motion and activity at once.</summary>
        public async Task StopAsync() => Check("stop_now_xxxxxxx", await link.StopAsync().ConfigureAwait(false));

        private async Task<Verdict> Demand(string command, TimeSpan timeout, params object[] tokens) =>
            Check(command, await link.SendAsync(command, timeout, tokens).ConfigureAwait(false));

        private static Verdict Check(string command, Verdict verdict)
        {
            if (verdict.Decision != Decision.Accepted)
            {
                throw new CommandRefusedException(command, verdict);
            }
            return verdict;
        }

        /// <summary>Position in m and quaternion x y z w of a right-handed frame.</summary>
        private static RigidPose FromWire(double[] n) => Handedness.Mirror(
            new RigidPose(new Vec3(n[0], n[1], n[2]), new Quat(n[3], n[4], n[5], n[6])));

        private static string InMillimetres(Vec3 point)
        {
            Vec3 p = 1e3 * Handedness.Mirror(point);
            return string.Format(CultureInfo.InvariantCulture, "{0:F5}_{1:F5}_{2:F5}", p.X, p.Y, p.Z);
        }
    }
}
