using System;
using System.Collections.Generic;
using System.Globalization;
using System.Text;

namespace Capture2vr
{
    /// <summary>
    /// A reader of JSON (RFC 8259), since the engine's own needs a class for every shape and cannot be used without it.
    /// Objects become Dictionary, arrays List, numbers double, the rest string, bool or null.
    /// </summary>
    public sealed class Json
    {
        private const int Deepest = 64; // levels; ours have six, and a hostile text must not exhaust the stack

        private readonly string _text;
        private int _at;

        private Json(string text)
        {
            _text = text;
        }

        /// <summary>Throws FormatException for what is no JSON.</summary>
        public static object Parse(string text)
        {
            var reader = new Json(text);
            var value = reader.Value(0);
            reader.Space();
            if (reader._at < text.Length) throw reader.Fault("there is more behind the end");
            return value;
        }

        private object Value(int depth)
        {
            if (depth > Deepest) throw Fault("it is nested too deep");
            Space();
            switch (Peek())
            {
                case '{': return Members(depth);
                case '[': return Items(depth);
                case '"': return Text();
                case 't': return Word("true", true);
                case 'f': return Word("false", false);
                case 'n': return Word("null", null);
                default: return Number();
            }
        }

        private Dictionary<string, object> Members(int depth)
        {
            var members = new Dictionary<string, object>();
            for (_at++; !Ends('}', members.Count); )
            {
                Space();
                var name = Text();
                Space();
                Take(':');
                members[name] = Value(depth + 1);
            }
            return members;
        }

        private List<object> Items(int depth)
        {
            var items = new List<object>();
            for (_at++; !Ends(']', items.Count); ) items.Add(Value(depth + 1));
            return items;
        }

        /// <summary>Whether the list is over; else steps over the comma, which the first item does not have.</summary>
        private bool Ends(char bracket, int count)
        {
            Space();
            if (Peek() == bracket)
            {
                _at++;
                return true;
            }
            if (count > 0) Take(',');
            return false;
        }

        private string Text()
        {
            Take('"');
            var text = new StringBuilder();
            while (Peek() != '"')
            {
                var letter = _text[_at++];
                if (letter < ' ') throw Fault("a string has a control character");
                text.Append(letter == '\\' ? Escaped() : letter);
            }
            _at++;
            return text.ToString();
        }

        private char Escaped()
        {
            var letter = Peek();
            _at++;
            if (letter == 'u') return Unicode();
            var place = "\"\\/bfnrt".IndexOf(letter);
            if (place < 0) throw Fault("a string has an unknown escape");
            return "\"\\/\b\f\n\r\t"[place];
        }

        private char Unicode()
        {
            if (_at + 4 > _text.Length) throw Fault("it ends in the middle");
            var digits = _text.Substring(_at, 4);
            _at += 4;
            if (ushort.TryParse(digits, NumberStyles.AllowHexSpecifier, CultureInfo.InvariantCulture, out var code)) return (char)code;
            throw Fault("a string has an unknown escape");
        }

        private object Word(string word, object value)
        {
            if (string.CompareOrdinal(_text, _at, word, 0, word.Length) != 0) throw Fault("there is no value");
            _at += word.Length;
            return value;
        }

        private object Number()
        {
            var start = _at;
            while (_at < _text.Length && "+-0123456789.eE".IndexOf(_text[_at]) >= 0) _at++;
            var digits = _text.Substring(start, _at - start);
            if (double.TryParse(digits, NumberStyles.Float, CultureInfo.InvariantCulture, out var number)) return number;
            throw Fault("there is no value");
        }

        private void Space()
        {
            while (_at < _text.Length && " \t\r\n".IndexOf(_text[_at]) >= 0) _at++;
        }

        private void Take(char wanted)
        {
            if (Peek() != wanted) throw Fault($"there is no {wanted}");
            _at++;
        }

        private char Peek()
        {
            if (_at >= _text.Length) throw Fault("it ends in the middle");
            return _text[_at];
        }

        private FormatException Fault(string reason) => new FormatException($"no JSON at letter {_at}: {reason}");
    }

    /// <summary>Steps into what Json gives; each throws FormatException where something else is there.</summary>
    public static class JsonSteps
    {
        public static object In(this object value, string name)
        {
            if (value is Dictionary<string, object> members && members.TryGetValue(name, out var found)) return found;
            throw new FormatException($"there is no \"{name}\"");
        }

        /// <summary>Whether there is something of that name; here nothing is thrown.</summary>
        public static bool Has(this object value, string name) => value is Dictionary<string, object> members && members.ContainsKey(name);

        public static List<object> List(this object value) => As<List<object>>(value, "list");

        public static string Text(this object value) => As<string>(value, "text");

        public static long Whole(this object value)
        {
            // Beyond 2^53 a double skips numbers; no count of ours comes near.
            if (value is double number && Math.Floor(number) == number && Math.Abs(number) < 9e15) return (long)number;
            throw new FormatException("there is no whole number");
        }

        /// <summary>The item at a place that the document itself tells.</summary>
        public static object At(this List<object> items, long place)
        {
            if (place >= 0 && place < items.Count) return items[(int)place];
            throw new FormatException($"there is no item {place} of {items.Count}");
        }

        private static T As<T>(object value, string kind) where T : class
        {
            return value as T ?? throw new FormatException($"there is no {kind}");
        }
    }
}
