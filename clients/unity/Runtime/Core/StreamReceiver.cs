using System;
using System.Collections.Generic;
using System.Diagnostics;
using System.Net;
using System.Net.Sockets;
using System.Threading;

namespace Pcmrs
{
    /// <summary>
    /// Receives the streams of one port, on its own thread, and keeps the newest of each kind.
    /// Ask it from any thread.
    /// </summary>
    public sealed class StreamReceiver : IDisposable
    {
        private const int MaxBytes = 512;
        private const int MaxDrained = 512;
        private const int PollMicroseconds = 100000;

        private readonly Socket socket;
        private readonly IPAddress daemon;
        private readonly Thread thread;
        private readonly object gate = new object();
        private readonly Dictionary<StreamKind, Heard> newest = new Dictionary<StreamKind, Heard>();
        private readonly Stopwatch clock = Stopwatch.StartNew();
        private volatile bool ended;
        private long received, refused;

        /// <param name="daemon">Where the daemon sends from; datagrams of others are refused.</param>
        /// <param name="port">Such as 8051, the stream port of mixed reality; 0 takes a free one.</param>
        public StreamReceiver(IPAddress daemon, int port)
        {
            this.daemon = daemon;
            socket = new Socket(AddressFamily.InterNetwork, SocketType.Dgram, ProtocolType.Udp);
            socket.Bind(new IPEndPoint(IPAddress.Any, port));
            Port = ((IPEndPoint)socket.LocalEndPoint).Port;
            thread = new Thread(Receive) { IsBackground = true, Name = "PCMRS streams" };
            thread.Start();
        }

        public int Port { get; }

        /// <summary>Datagrams that came.</summary>
        public long Received => Interlocked.Read(ref received);

        /// <summary>Of these, those that were no message of a stream, or came from elsewhere.</summary>
        public long Refused => Interlocked.Read(ref refused);

        /// <summary>The newest message of a kind, if one came within the last `within` seconds; null otherwise.</summary>
        public StreamMessage Newest(StreamKind kind, double within)
        {
            lock (gate)
            {
                Heard heard;
                bool fresh = newest.TryGetValue(kind, out heard) && clock.Elapsed.TotalSeconds - heard.At <= within;
                return fresh ? heard.Message : null;
            }
        }

        public void Dispose()
        {
            ended = true;
            thread.Join();
            socket.Close();
        }

        private void Receive()
        {
            var buffer = new byte[MaxBytes];
            while (!ended)
            {
                if (socket.Poll(PollMicroseconds, SelectMode.SelectRead))
                {
                    Drain(buffer);
                }
            }
        }

        /// <summary>Takes all that waits before anybody is shown any of it: after a pause the rest is old.</summary>
        private void Drain(byte[] buffer)
        {
            var drained = new Dictionary<StreamKind, StreamMessage>();
            int count = 0;
            do
            {
                StreamMessage message = ReceiveOne(buffer);
                if (message != null)
                {
                    drained[message.Kind] = message;
                }
            }
            while (socket.Available > 0 && ++count < MaxDrained);
            lock (gate)
            {
                foreach (KeyValuePair<StreamKind, StreamMessage> pair in drained)
                {
                    newest[pair.Key] = new Heard { Message = pair.Value, At = clock.Elapsed.TotalSeconds };
                }
            }
        }

        private StreamMessage ReceiveOne(byte[] buffer)
        {
            EndPoint from = new IPEndPoint(IPAddress.Any, 0);
            try
            {
                int length = socket.ReceiveFrom(buffer, ref from);
                Interlocked.Increment(ref received);
                if (((IPEndPoint)from).Address.Equals(daemon) && length < buffer.Length)
                {
                    return StreamMessage.Parse(buffer, length);
                }
            }
            catch (FormatException)
            {
            }
            catch (SocketException)
            {
                // On Windows a datagram longer than the buffer; elsewhere it fills the buffer.
            }
            Interlocked.Increment(ref refused);
            return null;
        }

        private struct Heard
        {
            public StreamMessage Message;
            public double At;
        }
    }
}
