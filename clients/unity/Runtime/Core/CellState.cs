using System;
using System.Collections.Generic;

namespace Pcmrs
{
    /// <summary>The joint state of all branches after one commit.</summary>
    public sealed class CellState
    {
        /// <summary>Grows with each commit.</summary>
        public readonly long Sequence;

        /// <summary>State by branch, such as "111" of "registration".</summary>
        public readonly IReadOnlyDictionary<string, string> Branches;

        /// <summary>Flags by name, such as "registered".</summary>
        public readonly IReadOnlyDictionary<string, bool> Flags;

        /// <summary>Running operations, as `branch.operation`.</summary>
        public readonly IReadOnlyList<string> Running;

        /// <summary>Whether a Stop holds until an operator acknowledges it.</summary>
        public readonly bool Latched;

        /// <summary>Id of the accepted tool plan; null when there is none.</summary>
        public readonly string Plan;

        /// <summary>Id of the accepted registration; null when there is none.</summary>
        public readonly string Registration;

        private CellState(Dictionary<string, object> fields)
        {
            Sequence = (long)(double)fields["sequence"];
            Latched = (bool)fields["latched"];
            Plan = (string)fields["plan"];
            Registration = (string)fields["registration"];
            var branches = new Dictionary<string, string>();
            foreach (KeyValuePair<string, object> pair in (Dictionary<string, object>)fields["branches"])
            {
                branches[pair.Key] = (string)pair.Value;
            }
            Branches = branches;
            var flags = new Dictionary<string, bool>();
            foreach (KeyValuePair<string, object> pair in (Dictionary<string, object>)fields["flags"])
            {
                flags[pair.Key] = (bool)pair.Value;
            }
            Flags = flags;
            var running = new List<string>();
            foreach (object each in (List<object>)fields["running"])
            {
                running.Add((string)each);
            }
            Running = running;
        }

        /// <summary>Reads the text of `PcmrsState`.</summary>
        /// <exception cref="FormatException">It is no state.</exception>
        public static CellState Parse(string json)
        {
            try
            {
                return new CellState((Dictionary<string, object>)Json.Parse(json));
            }
            catch (Exception error) when (
                error is KeyNotFoundException || error is InvalidCastException || error is NullReferenceException)
            {
                throw new FormatException("this is no state: " + error.Message);
            }
        }
    }
}
