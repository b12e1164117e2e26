using System;

namespace Pcmrs
{
    public enum Decision
    {
        Accepted,
        Rejected,
        Failed,
    }

    /// <summary>What became of a command.</summary>
    public sealed class Verdict
    {
        /// <summary>Branch of the workflow that the command is about.</summary>
        public readonly string Branch;

        /// <summary>State of that branch when the command had ended.</summary>
        public readonly string State;

        /// <summary>Code of the refusal; null when accepted.</summary>
        public readonly string Reason;

        /// <summary>Results of an accepted command, in frames and units of the wire.</summary>
        public readonly double[] Results;

        public readonly Decision Decision;

        private static readonly double[] NoResults = new double[0];

        private Verdict(Decision decision, string branch, string state, string reason, double[] results)
        {
            Decision = decision;
            Branch = branch;
            State = state;
            Reason = reason;
            Results = results;
        }

        /// <summary>Reads a verdict reply; `id` becomes that of the command.</summary>
        /// <exception cref="FormatException">It is none.</exception>
        public static Verdict Parse(string reply, out string id)
        {
            string[] parts = reply.TrimEnd(';').Split(new[] { '_' }, 5);
            if (parts.Length < 4)
            {
                throw new FormatException("'" + reply + "' is no verdict reply");
            }
            id = parts[0];
            string branch = parts[2], state = parts[3], rest = parts.Length == 5 ? parts[4] : null;
            switch (parts[1])
            {
                case "accepted":
                    double[] results = rest == null ? NoResults : Numbers.Parse(rest.Split('_'));
                    return new Verdict(Decision.Accepted, branch, state, null, results);
                case "rejected":
                    return new Verdict(Decision.Rejected, branch, state, rest, NoResults);
                case "failed":
                    return new Verdict(Decision.Failed, branch, state, rest, NoResults);
                default:
                    throw new FormatException("'" + parts[1] + "' is no decision");
            }
        }
    }

    /// <summary>A command was rejected, or has failed.</summary>
    public sealed class CommandRefusedException : Exception
    {
        public readonly Verdict Verdict;

        public CommandRefusedException(string command, Verdict verdict) : base(
            command + " was " + verdict.Decision.ToString().ToLowerInvariant() + " in " + verdict.Branch + " "
            + verdict.State + ": " + verdict.Reason)
        {
            Verdict = verdict;
        }
    }

    /// <summary>No verdict came in time: the command may have been performed or not. Look at the state.</summary>
    public sealed class UnknownOutcomeException : Exception
    {
        public UnknownOutcomeException(string command) : base(
            "no verdict on " + command + " came in time; look at the daemon's state before you go on")
        {
        }
    }
}
