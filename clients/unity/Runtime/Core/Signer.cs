using System;
using System.Globalization;
using System.IO;
using System.Security.Cryptography;
using System.Text;
using System.Text.RegularExpressions;

namespace Pcmrs
{
    /// <summary>
    /// Signs PCMRS string commands. It can be copied into other programs: it needs nothing else.
    /// Sign a command anew each time that it is sent, also when it is sent again: the daemon takes every counter once.
    /// </summary>
    public sealed class Signer
    {
        /// <summary>Send this first on a TCP connection whose commands are signed.</summary>
        public const string Opening = "|;";

        private const long NanosecondsPerTick = 100;
        private static readonly DateTime Epoch = new DateTime(1970, 1, 1, 0, 0, 0, DateTimeKind.Utc);

        private readonly string peer;
        private readonly byte[] key;
        private readonly Func<long> counter;
        private long last;

        /// <summary>A signer whose counters are nanoseconds since 1970.</summary>
        public Signer(string peer, byte[] key) : this(peer, key, Now)
        {
        }

        /// <param name="peer">Its name in the daemon's configuration.</param>
        /// <param name="key">Its key, 32 bytes.</param>
        /// <param name="counter">Gives a number that grows.</param>
        public Signer(string peer, byte[] key, Func<long> counter)
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
            last = Math.Max(last + 1, counter());
            string covered = command + "|" + peer + "|" + last.ToString(CultureInfo.InvariantCulture);
            using (var mac = new HMACSHA256(key))
            {
                string tag = BitConverter.ToString(mac.ComputeHash(Encoding.ASCII.GetBytes(covered)), 0, 16);
                return Encoding.ASCII.GetBytes(covered + "|" + tag.Replace("-", "").ToLowerInvariant());
            }
        }

        /// <summary>The same for a TCP connection that began with <see cref="Opening"/>.</summary>
        public byte[] Frame(string command)
        {
            byte[] signed = Sign(command);
            Array.Resize(ref signed, signed.Length + 1);
            signed[signed.Length - 1] = (byte)';';
            return signed;
        }

        private static long Now()
        {
            return (DateTime.UtcNow - Epoch).Ticks * NanosecondsPerTick;
        }
    }
}
