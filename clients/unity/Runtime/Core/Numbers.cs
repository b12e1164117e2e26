using System;
using System.Globalization;

namespace Pcmrs
{
    /// <summary>Numbers on the wire: decimal, finite, the same in every country.</summary>
    internal static class Numbers
    {
        /// <exception cref="FormatException">A token is no finite number.</exception>
        public static double[] Parse(string[] tokens)
        {
            var numbers = new double[tokens.Length];
            for (int index = 0; index < tokens.Length; index++)
            {
                numbers[index] = Parse(tokens[index]);
            }
            return numbers;
        }

        public static double Parse(string token)
        {
            const NumberStyles Decimal =
                NumberStyles.AllowLeadingSign | NumberStyles.AllowDecimalPoint | NumberStyles.AllowExponent;
            double number;
            if (!double.TryParse(token, Decimal, CultureInfo.InvariantCulture, out number) || !IsFinite(number))
            {
                throw new FormatException("'" + token + "' is no number");
            }
            return number;
        }

        /// <exception cref="ArgumentException">It is not finite.</exception>
        public static string Format(double number)
        {
            if (!IsFinite(number))
            {
                throw new ArgumentException("a number that is not finite cannot be sent");
            }
            return number.ToString("R", CultureInfo.InvariantCulture);
        }

        private static bool IsFinite(double number) => !double.IsNaN(number) && !double.IsInfinity(number);
    }
}
