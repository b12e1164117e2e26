using System;
using System.Collections.Generic;
using System.Globalization;
using System.Text;

namespace Pcmrs
{
    /// <summary>
    /// Reads JSON: objects as dictionaries, arrays as lists, numbers as double. Unity's own reader needs UnityEngine and
    /// knows no dictionaries.
    /// </summary>
    internal sealed class Json
    {
        private const int MaxDepth = 32;

        private readonly string text;
        private int at;

        private Json(string text)
        {
            this.text = text;
        }

        /// <exception cref="FormatException">It is no JSON.</exception>
        public static object Parse(string text)
        {
            var reader = new Json(text);
            object value = reader.Value(0);
            if (reader.Peek() != '\0')
            {
                throw reader.Wrong();
            }
            return value;
        }

        private object Value(int depth)
        {
            if (depth > MaxDepth)
            {
                throw Wrong();
            }
            switch (Peek())
            {
                case '{':
                    return Members(depth);
                case '[':
                    return Elements(depth);
                case '"':
                    return Text();
                case 't':
                    return Word("true", true);
                case 'f':
                    return Word("false", false);
                case 'n':
                    return Word("null", null);
                default:
                    return Number();
            }
        }

        private Dictionary<string, object> Members(int depth)
        {
            var members = new Dictionary<string, object>();
            Expect('{');
            while (Peek() != '}')
            {
                if (members.Count > 0)
                {
                    Expect(',');
                }
                string name = Text();
                Expect(':');
                members[name] = Value(depth + 1);
            }
            Expect('}');
            return members;
        }

        private List<object> Elements(int depth)
        {
            var elements = new List<object>();
            Expect('[');
            while (Peek() != ']')
            {
                if (elements.Count > 0)
                {
                    Expect(',');
                }
                elements.Add(Value(depth + 1));
            }
            Expect(']');
            return elements;
        }

        private string Text()
        {
            Expect('"');
            var read = new StringBuilder();
            while (true)
            {
                char letter = Next();
                if (letter == '"')
                {
                    return read.ToString();
                }
                read.Append(letter == '\\' ? Escaped(Next()) : letter);
            }
        }

        private char Escaped(char letter)
        {
            switch (letter)
            {
                case 'b':
                    return '\b';
                case 'f':
                    return '\f';
                case 'n':
                    return '\n';
                case 'r':
                    return '\r';
                case 't':
                    return '\t';
                case 'u':
                    var digits = new string(new[] { Next(), Next(), Next(), Next() });
                    ushort code;
                    if (!ushort.TryParse(digits, NumberStyles.AllowHexSpecifier, CultureInfo.InvariantCulture, out code))
                    {
                        throw Wrong();
                    }
                    return (char)code;
                case '"':
                case '\\':
                case '/':
                    return letter;
                default:
                    throw Wrong();
            }
        }

        private double Number()
        {
            int first = at;
            while (at < text.Length && (char.IsDigit(text[at]) || "+-.eE".IndexOf(text[at]) >= 0))
            {
                at++;
            }
            return Numbers.Parse(text.Substring(first, at - first));
        }

        private object Word(string word, object value)
        {
            foreach (char letter in word)
            {
                if (Next() != letter)
                {
                    throw Wrong();
                }
            }
            return value;
        }

        /// <summary>The next letter that is no space, not taken; 0 at the end.</summary>
        private char Peek()
        {
            while (at < text.Length && " \t\r\n".IndexOf(text[at]) >= 0)
            {
                at++;
            }
            return at < text.Length ? text[at] : '\0';
        }

        private char Next()
        {
            if (at >= text.Length)
            {
                throw Wrong();
            }
            return text[at++];
        }

        private void Expect(char letter)
        {
            if (Peek() != letter)
            {
                throw Wrong();
            }
            at++;
        }

        private FormatException Wrong() => new FormatException("no JSON at character " + at);
    }
}
