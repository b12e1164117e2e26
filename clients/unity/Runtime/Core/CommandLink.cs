using System;
using System.Collections.Generic;
using System.Globalization;
using System.Net;
using System.Net.Sockets;
using System.Security.Cryptography;
using System.Text;
using System.Threading;
using System.Threading.Tasks;

namespace Pcmrs
{
    /// <summary>
    /// Sends string commands and brings back their verdicts; use it from any thread.
    ///
    /// Every command has an id and is sent again with the same id until it is answered. The daemon runs an id once and
    /// answers a repetition with the recorded verdict, so that a lost datagram, either way, runs nothing twice. It knows
    /// a client by its port, or by the name it signs with: the socket is kept for as long as this object lives.
    /// </summary>
    public sealed class CommandLink : IDisposable
    {
        /// <summary>Most bytes of a command, its terminator included.</summary>
        public const int MaxBytes = 256;

        private const int NameLength = 16;
        private const int MaxReply = 1024;
        private const int PollMicroseconds = 100000;
        private static readonly TimeSpan RepeatAfter = TimeSpan.FromSeconds(0.5);
        private static readonly TimeSpan RepeatAtMost = TimeSpan.FromSeconds(1.0);
        private static readonly TimeSpan StopRepeatAfter = TimeSpan.FromSeconds(0.1);
        private static readonly TimeSpan StopTimeout = TimeSpan.FromSeconds(10.0);

        private readonly Socket socket;
        private readonly Signer signer;
        private readonly Thread thread;
        private readonly object sending = new object();
        private readonly object gate = new object();
        private readonly Dictionary<string, TaskCompletionSource<Verdict>> waiting =
            new Dictionary<string, TaskCompletionSource<Verdict>>();
        private long lastId;
        private volatile bool ended;

        /// <param name="daemon">A command link of the daemon, such as that of the planner, port 8057.</param>
        /// <param name="signer">Signs the commands and checks the answers; unsigned ones are taken on the daemon's own machine only.</param>
        public CommandLink(IPEndPoint daemon, Signer signer = null)
        {
            this.signer = signer;
            lastId = RandomId();
            socket = new Socket(AddressFamily.InterNetwork, SocketType.Dgram, ProtocolType.Udp);
            socket.Connect(daemon); // from now on only datagrams of this address are received
            thread = new Thread(Receive) { IsBackground = true, Name = "PCMRS verdicts" };
            thread.Start();
        }

        /// <summary>Sends a command; the verdict comes when its outcome is known.</summary>
        /// <param name="command">Its 16 characters.</param>
        /// <param name="timeout">How long to wait, that is how long the operation may take.</param>
        /// <param name="tokens">Its payload: int for an index, double for a number, string for a path.</param>
        /// <exception cref="UnknownOutcomeException">No verdict came in time.</exception>
        /// <exception cref="ArgumentException">The command would break the grammar.</exception>
        public Task<Verdict> SendAsync(string command, TimeSpan timeout, params object[] tokens) =>
            SendAsync(command, timeout, RepeatAfter, RepeatAtMost, tokens);

        /// <summary>
        /// Stops everything at once; sent from the calling thread, and again every 0.1 s until it is answered.
        /// </summary>
        /// <exception cref="UnknownOutcomeException">No answer came: the robot may still move.</exception>
        public Task<Verdict> StopAsync() =>
            SendAsync("stop_now_xxxxxxx", StopTimeout, StopRepeatAfter, StopRepeatAfter);

        /// <summary>
        /// Sends a message that is no command and is never answered. Without a signer the daemon takes it on its own
        /// machine only; a signed message is ended like a command.
        /// </summary>
        internal void SendMessage(string message) => Transmit(signer == null ? message : message + ";");

        /// <summary>Closes the socket; commands without a verdict are cancelled here, and go on in the daemon.</summary>
        public void Dispose()
        {
            ended = true;
            thread.Join();
            socket.Close();
            lock (gate)
            {
                foreach (TaskCompletionSource<Verdict> answer in waiting.Values)
                {
                    answer.TrySetCanceled();
                }
            }
        }

        private Task<Verdict> SendAsync(
            string command, TimeSpan timeout, TimeSpan repeatAfter, TimeSpan repeatAtMost, params object[] tokens)
        {
            if (ended)
            {
                throw new ObjectDisposedException("CommandLink");
            }
            string id = Interlocked.Increment(ref lastId).ToString(CultureInfo.InvariantCulture);
            string text = Format(command, tokens, id);
            var answer = new TaskCompletionSource<Verdict>(TaskCreationOptions.RunContinuationsAsynchronously);
            lock (gate)
            {
                waiting[id] = answer;
            }
            Transmit(text);
            return AnswerAsync(command, text, id, answer.Task, timeout, repeatAfter, repeatAtMost);
        }

        private async Task<Verdict> AnswerAsync(
            string command, string text, string id, Task<Verdict> answer, TimeSpan timeout, TimeSpan interval,
            TimeSpan repeatAtMost)
        {
            Task expiry = Task.Delay(timeout);
            try
            {
                while (await Task.WhenAny(answer, expiry, Task.Delay(interval)).ConfigureAwait(false) != answer)
                {
                    if (expiry.IsCompleted)
                    {
                        throw new UnknownOutcomeException(command);
                    }
                    Transmit(text);
                    interval = interval + interval < repeatAtMost ? interval + interval : repeatAtMost;
                }
                return await answer.ConfigureAwait(false);
            }
            finally
            {
                lock (gate)
                {
                    waiting.Remove(id);
                }
            }
        }

        /// <summary>Signs each time again: the daemon accepts no datagram twice.</summary>
        private void Transmit(string text)
        {
            lock (sending) // so that counters leave in their order
            {
                Transmit(signer == null ? Encoding.ASCII.GetBytes(text) : signer.Sign(text));
            }
        }

        private void Transmit(byte[] datagram)
        {
            try
            {
                socket.Send(datagram);
            }
            catch (SocketException)
            {
                // The network is down, or the daemon's port was closed a moment ago: the repetition goes on.
            }
            catch (ObjectDisposedException)
            {
            }
        }

        private void Receive()
        {
            var buffer = new byte[MaxReply];
            while (!ended)
            {
                try
                {
                    if (socket.Poll(PollMicroseconds, SelectMode.SelectRead))
                    {
                        Take(Encoding.ASCII.GetString(buffer, 0, socket.Receive(buffer)));
                    }
                }
                catch (SocketException)
                {
                    // Nobody listens at the daemon's port now.
                }
                catch (FormatException)
                {
                    // No verdict, or not the daemon's; a client that waits for one gets it when it repeats the command.
                }
            }
        }

        private void Take(string reply)
        {
            string id;
            Verdict verdict = Verdict.Parse(signer == null ? reply : signer.Check(reply), out id);
            lock (gate)
            {
                TaskCompletionSource<Verdict> answer;
                if (waiting.TryGetValue(id, out answer))
                {
                    answer.TrySetResult(verdict);
                }
            }
        }

        private static string Format(string command, object[] tokens, string id)
        {
            var text = new StringBuilder(command);
            foreach (object token in tokens)
            {
                text.Append('_').Append(Format(token));
            }
            text.Append("_#").Append(id).Append(';');
            string whole = text.ToString();
            if (command.Length != NameLength || whole.Length > MaxBytes || !IsOneCommand(whole))
            {
                throw new ArgumentException("'" + whole + "' is no command");
            }
            return whole;
        }

        private static string Format(object token)
        {
            if (token is int)
            {
                return ((int)token).ToString("00", CultureInfo.InvariantCulture);
            }
            return token is double ? Numbers.Format((double)token) : (string)token;
        }

        /// <summary>Printable ASCII, with a terminator at its end only.</summary>
        private static bool IsOneCommand(string text)
        {
            for (int index = 0; index < text.Length; index++)
            {
                if (text[index] < ' ' || text[index] > '~' || (text[index] == ';') != (index == text.Length - 1))
                {
                    return false;
                }
            }
            return true;
        }

        /// <summary>A port may be that of an earlier client, whose ids the daemon remembers.</summary>
        private static long RandomId()
        {
            var bytes = new byte[8];
            using (var random = RandomNumberGenerator.Create())
            {
                random.GetBytes(bytes);
            }
            return (long)(BitConverter.ToUInt64(bytes, 0) % 9000000000UL);
        }
    }
}
