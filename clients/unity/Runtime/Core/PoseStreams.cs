using System;
using System.Threading;
using System.Threading.Tasks;

namespace Pcmrs
{
    /// <summary>
    /// The streams of mixed reality: tool, target and registration, as they are now.
    ///
    /// The daemon sends target and registration once per change, and never that they are gone. So the streams are asked
    /// for again every 2 s, upon which it sends both once more: lost messages come again, outdated targets
    /// are forgotten, and a restarted daemon is found.
    /// </summary>
    public sealed class PoseStreams : IDisposable
    {
        private const double ToolLifetime = 0.5;
        private const double OthersLifetime = 5.0;
        private static readonly TimeSpan Renewal = TimeSpan.FromSeconds(2.0);

        private readonly StreamReceiver receiver;
        private readonly Planner planner;
        private readonly CancellationTokenSource ending = new CancellationTokenSource();
        private volatile Exception failure;

        public PoseStreams(StreamReceiver receiver, Planner planner)
        {
            this.receiver = receiver;
            this.planner = planner;
            Task.Run(Renew);
        }

        /// <summary>Why the daemon did not begin the streams when it was asked last; null when it did.</summary>
        public Exception Failure => failure;

        /// <summary>The pose of tool, target or registration; false where it is not known now.</summary>
        public bool TryGet(StreamKind kind, out RigidPose pose)
        {
            double lifetime = kind == StreamKind.Tool ? ToolLifetime : OthersLifetime;
            StreamMessage message = receiver.Newest(kind, lifetime);
            pose = message == null ? RigidPose.Identity : message.Pose;
            return message != null;
        }

        /// <summary>Asks no more; other clients still receive the streams.</summary>
        public void Dispose() => ending.Cancel();

        private async Task Renew()
        {
            while (!ending.IsCancellationRequested)
            {
                try
                {
                    await planner.StartPosesAsync().ConfigureAwait(false);
                    failure = null;
                }
                catch (Exception error) when (error is CommandRefusedException || error is UnknownOutcomeException)
                {
                    failure = error;
                }
                await Task.Delay(Renewal, ending.Token).ConfigureAwait(false);
            }
        }
    }
}
