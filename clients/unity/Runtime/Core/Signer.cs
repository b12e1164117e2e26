using System;
using System.Globalization;
using System.IO;
using System.Security.Cryptography;
using System.Text;
using System.Text.RegularExpressions;

namespace Pcmrs
{
    /// <summary>
    /// Signs PCMRS string commands, and checks the answers. It can be copied into other programs: it needs nothing else.
    /// Sign a command each time that it is sent, also when it is repeated: the daemon accepts each counter once.
    /// </summary>
    public sealed class Signer
    {
        /// <summary>Send this first on a TCP connection whose commands are signed.</summary>
        public const string Opening = "|;";

        private const long NanosecondsPerTick = 100;
        private static readonly DateTime Epoch = new DateTime(1970, 1, 1, 0, 0, 0, DateTimeKind.Utc);

        private static readonly Regex Answer =
            new Regex(@"\A(([ -:<-~]*;)\|([A-Za-z0-9_-]{1,32})\|([1-9][0-9]{0,18}))\|([0-9a-f]{32})\z");

        private readonly string peer;
        private readonly byte[] key;
        private readonly Func<long> counter;
        private readonly bool answersSigned;
        private readonly object gate = new object();
        private long first;
        private long last;

        /// <summary>A signer whose counters are nanoseconds since 1970.</summary>
        public Signer(string peer, byte[] key, bool answersSigned = false) : this(peer, key, Now, answersSigned)
        {
        }

        /// <param name="peer">Its name in the daemon's configuration.</param>
        /// <param name="key">Its key, 32 bytes.</param>
        /// <param name="counter">Gives a number that grows.</param>
        /// <param name="answersSigned">
        /// Whether an answer without a signature is refused. The daemon signs its answers to peers with
        /// `counter = "unix_ns"` in its configuration, and to no others.
        /// </param>
        public Signer(string peer, byte[] key, Func<long> counter, bool answersSigned = false)
        {
            if (!Regex.IsMatch(peer, @"\A[A-Za-z0-9_-]{1,32}\z"))
            {
                throw new ArgumentException("a peer's name has 1 to 32 letters, digits, '-' and '_'", "peer");
            }
            if (key.Length != 32)
            {
                throw new ArgumentException("a key has 32 bytes, not " + key.Length, "key");
            }
            this.peer = peer;
            this.key = key;
            this.counter = counter;
            this.answersSigned = answersSigned;
        }

        /// <summary>Reads a key file that `pcmrs peers new` has made: 64 hex digits.</summary>
        public static byte[] ReadKey(string path)
        {
            string hex = File.ReadAllText(path).Trim();
            var bytes = new byte[hex.Length / 2];
            for (int index = 0; index < bytes.Length; index++)
            {
                bytes[index] = Convert.ToByte(hex.Substring(2 * index, 2), 16);
            }
            return bytes;
        }

        /// <summary>The datagram of a command, which ends with `;`.</summary>
        public byte[] Sign(string command)
        {
            long number;
            lock (gate)
            {
                last = Math.Max(last + 1, counter());
                first = first == 0 ? last : first;
                number = last;
            }
            string covered = command + "|" + peer + "|" + number.ToString(CultureInfo.InvariantCulture);
            return Encoding.ASCII.GetBytes(covered + "|" + Tag(covered));
        }

        /// <summary>The same for a TCP connection that began with <see cref="Opening"/>.</summary>
        public byte[] Frame(string command)
        {
            byte[] signed = Sign(command);
            Array.Resize(ref signed, signed.Length + 1);
            signed[signed.Length - 1] = (byte)';';
            return signed;
        }

        /// <summary>An answer without its signature.</summary>
        /// <exception cref="FormatException">
        /// The daemon did not sign it for this peer, or it answers no command that this has signed.
        /// </exception>
        public string Check(string answer)
        {
            Match match = Answer.Match(answer);
            if (!match.Success)
            {
                if (answersSigned || answer.IndexOf('|') >= 0)
                {
                    throw new FormatException("'" + answer + "' is no signed answer");
                }
                return answer;
            }
            long number;
            bool ours = long.TryParse(match.Groups[4].Value, NumberStyles.None, CultureInfo.InvariantCulture, out number);
            lock (gate)
            {
                ours = ours && match.Groups[3].Value == peer && first > 0 && first <= number && number <= last;
            }
            // The zero byte is in no command, so none can be sent back as an answer.
            if (!(ours && IsSame(match.Groups[5].Value, Tag("\0" + match.Groups[1].Value))))
            {
                throw new FormatException("'" + answer + "' is no answer to this client, or its signature does not hold");
            }
            return match.Groups[2].Value;
        }

        private string Tag(string covered)
        {
            using (var mac = new HMACSHA256(key))
            {
                string tag = BitConverter.ToString(mac.ComputeHash(Encoding.ASCII.GetBytes(covered)), 0, 16);
                return tag.Replace("-", "").ToLowerInvariant();
            }
        }

        /// <summary>Takes as long wherever the two differ.</summary>
        private static bool IsSame(string one, string other)
        {
            int different = one.Length ^ other.Length;
            for (int index = 0; index < one.Length && index < other.Length; index++)
            {
                different |= one[index] ^ other[index];
            }
            return different == 0;
        }

        private static long Now()
        {
            return (DateTime.UtcNow - Epoch).Ticks * NanosecondsPerTick;
        }
    }
}
