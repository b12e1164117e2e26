using System;
using System.Collections.Generic;
using System.Diagnostics;
using System.IO;
using System.Net;
using System.Net.Sockets;
using System.Text;
using System.Threading;

namespace Pcmrs
{
    /// <summary>
    /// Receives the state of the cell and its poses over OpenIGTLink, on its own thread, and connects again when the
    /// link breaks. It only reads. The daemon has to have `gateway.openigtlink.enabled`, as server, with poses TRANSFORM.
    /// </summary>
    public sealed class StateLink : IDisposable
    {
        private const int HeaderBytes = 58;
        private const int MaxBody = 1 << 20;
        private const int TransformNumbers = 12;
        private const double MetresPerMillimetre = 1e-3;

        /// <summary>The daemon tells its status every second; when it is silent for so long, the link is dead.</summary>
        private const int SilenceMilliseconds = 3000;
        private const int RetryMilliseconds = 1000;

        private readonly IPEndPoint daemon;
        private readonly object gate = new object();
        private readonly ManualResetEventSlim ending = new ManualResetEventSlim();
        private readonly Dictionary<string, Heard> poses = new Dictionary<string, Heard>();
        private readonly Stopwatch clock = Stopwatch.StartNew();
        private TcpClient connection;
        private CellState state;

        public StateLink(IPEndPoint daemon)
        {
            this.daemon = daemon;
            new Thread(Run) { IsBackground = true, Name = "PCMRS state" }.Start();
        }

        /// <summary>The newest state; null while the daemon is not heard.</summary>
        public CellState State
        {
            get
            {
                lock (gate)
                {
                    return state;
                }
            }
        }

        /// <summary>
        /// The pose of a name such as `CoilToTracker` or `FlangeToBase` (`XToY`: where X is in Y), in Unity's frame,
        /// if it came within the last `within` seconds. What the tracker does not see does not come.
        /// </summary>
        public bool TryGetPose(string name, double within, out RigidPose pose)
        {
            lock (gate)
            {
                Heard heard;
                bool fresh = poses.TryGetValue(name, out heard) && clock.Elapsed.TotalSeconds - heard.At <= within;
                pose = fresh ? heard.Pose : RigidPose.Identity;
                return fresh;
            }
        }

        /// <summary>Returns at once; a connection that is being made ends by itself.</summary>
        public void Dispose()
        {
            ending.Set();
            lock (gate)
            {
                connection?.Close();
            }
        }

        private void Run()
        {
            while (!ending.IsSet)
            {
                try
                {
                    Hear();
                }
                catch (Exception error) when (
                    error is IOException || error is SocketException || error is ObjectDisposedException
                    || error is InvalidOperationException || error is FormatException)
                {
                    // The daemon is absent, silent or speaks something else: all the same to who looks at the state.
                }
                lock (gate)
                {
                    state = null;
                    poses.Clear();
                }
                ending.Wait(RetryMilliseconds);
            }
        }

        private void Hear()
        {
            using (var client = new TcpClient(AddressFamily.InterNetwork))
            {
                lock (gate)
                {
                    connection = client;
                }
                IAsyncResult connecting = client.BeginConnect(daemon.Address, daemon.Port, null, null);
                if (!connecting.AsyncWaitHandle.WaitOne(SilenceMilliseconds))
                {
                    return;
                }
                client.EndConnect(connecting);
                client.ReceiveTimeout = SilenceMilliseconds;
                Stream stream = client.GetStream();
                while (!ending.IsSet)
                {
                    HearOne(stream);
                }
            }
        }

        private void HearOne(Stream stream)
        {
            byte[] header = Read(stream, HeaderBytes);
            ulong size = BigEndian(header, 42, 8);
            if (BigEndian(header, 0, 2) != 1 || size > MaxBody)
            {
                throw new FormatException("this is no OpenIGTLink as the daemon speaks it");
            }
            byte[] body = Read(stream, (int)size);
            string type = Name(header, 2, 12), name = Name(header, 14, 20);
            if (type == "TRANSFORM")
            {
                Keep(name, Transform(body));
            }
            else if (type == "STRING" && name == "PcmrsState")
            {
                CellState read = CellState.Parse(String(body));
                lock (gate)
                {
                    state = read;
                }
            }
        }

        private void Keep(string name, RigidPose pose)
        {
            lock (gate)
            {
                poses[name] = new Heard { Pose = pose, At = clock.Elapsed.TotalSeconds };
            }
        }

        /// <summary>Column by column the upper three rows of a matrix, right-handed, in mm.</summary>
        private static RigidPose Transform(byte[] body)
        {
            if (body.Length != 4 * TransformNumbers)
            {
                throw new FormatException("a TRANSFORM has 12 numbers");
            }
            var matrix = new double[4, 4];
            matrix[3, 3] = 1.0;
            for (int index = 0; index < TransformNumbers; index++)
            {
                matrix[index % 3, index / 3] = Single(body, 4 * index);
            }
            for (int row = 0; row < 3; row++)
            {
                matrix[row, 3] *= MetresPerMillimetre;
            }
            return RigidPose.FromMatrix(Handedness.Mirror(matrix));
        }

        private static string String(byte[] body)
        {
            if (body.Length < 4 || BigEndian(body, 2, 2) != (ulong)(body.Length - 4))
            {
                throw new FormatException("a STRING is not as long as it says");
            }
            return Encoding.ASCII.GetString(body, 4, body.Length - 4);
        }

        private static byte[] Read(Stream stream, int count)
        {
            var bytes = new byte[count];
            for (int have = 0; have < count;)
            {
                int more = stream.Read(bytes, have, count - have);
                if (more == 0)
                {
                    throw new EndOfStreamException();
                }
                have += more;
            }
            return bytes;
        }

        private static ulong BigEndian(byte[] bytes, int first, int count)
        {
            ulong number = 0;
            for (int index = first; index < first + count; index++)
            {
                number = number << 8 | bytes[index];
            }
            return number;
        }

        private static double Single(byte[] bytes, int first)
        {
            float number = BitConverter.ToSingle(BitConverter.GetBytes((uint)BigEndian(bytes, first, 4)), 0);
            if (float.IsNaN(number) || float.IsInfinity(number))
            {
                throw new FormatException("a TRANSFORM holds a number that is not finite");
            }
            return number;
        }

        private static string Name(byte[] bytes, int first, int count) =>
            Encoding.ASCII.GetString(bytes, first, count).TrimEnd('\0', ' ');

        private struct Heard
        {
            public RigidPose Pose;
            public double At;
        }
    }
}
