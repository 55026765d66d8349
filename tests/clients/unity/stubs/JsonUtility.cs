// Stand-in for Unity's JsonUtility: public and [SerializeField] fields of objects that are [Serializable], lists and arrays of
// them, texts, numbers, truth values and enumerations. What a text does not name keeps the value that it was made with.
using System;
using System.Collections;
using System.Collections.Generic;
using System.Globalization;
using System.Linq;
using System.Reflection;
using System.Runtime.Serialization;
using System.Text;

namespace UnityEngine
{
    public static class JsonUtility
    {
        public static T FromJson<T>(string json) => (T)FromJson(json, typeof(T));

        public static object FromJson(string json, Type type) => JsonFields.Made(new JsonText(json).Whole(), type);

        public static string ToJson(object obj)
        {
            var text = new StringBuilder();
            JsonFields.Write(obj, obj.GetType(), text);
            return text.ToString();
        }
    }

    /// <summary>Between values of .NET and what JSON has: dictionaries, lists, texts, numbers as text, truth values.</summary>
    internal static class JsonFields
    {
        private const BindingFlags All = BindingFlags.Instance | BindingFlags.Public | BindingFlags.NonPublic;

        public static object Made(object told, Type type)
        {
            if (type == typeof(string)) return told as string ?? "";
            if (type == typeof(bool)) return told is bool && (bool)told;
            if (told is Number) return ((Number)told).As(type);
            if (ElementOf(type) != null) return Several(told as List<object> ?? new List<object>(), type);
            if (type.IsPrimitive || type.IsEnum) return Activator.CreateInstance(type);
            var made = New(type);
            Fill(made, type, told as Dictionary<string, object> ?? new Dictionary<string, object>());
            return made;
        }

        public static void Write(object value, Type type, StringBuilder text)
        {
            if (type == typeof(string)) Quote((string)value ?? "", text);
            else if (type == typeof(bool)) text.Append((bool)value ? "true" : "false");
            else if (type.IsEnum) text.Append(System.Convert.ToInt64(value, CultureInfo.InvariantCulture));
            else if (type.IsPrimitive) text.Append(((IFormattable)value).ToString(null, CultureInfo.InvariantCulture));
            else if (ElementOf(type) != null) WriteAll('[', ']', Elements(value, type), text);
            else WriteAll('{', '}', Members(value, type), text);
        }

        private static void Fill(object made, Type type, Dictionary<string, object> told)
        {
            foreach (var field in Fields(type))
            {
                if (told.TryGetValue(field.Name, out var value) || field.GetValue(made) == null) field.SetValue(made, Made(value, field.FieldType));
            }
        }

        /// <summary>Unity's serializer needs no constructor.</summary>
        private static object New(Type type)
        {
            var hasOne = type.IsValueType || type.GetConstructor(All, null, Type.EmptyTypes, null) != null;
            return hasOne ? Activator.CreateInstance(type, true) : FormatterServices.GetUninitializedObject(type);
        }

        private static object Several(List<object> told, Type type)
        {
            var element = ElementOf(type);
            var all = Array.CreateInstance(element, told.Count);
            for (var place = 0; place < told.Count; place++) all.SetValue(Made(told[place], element), place);
            return type.IsArray ? all : Activator.CreateInstance(type, all);
        }

        private static Type ElementOf(Type type)
        {
            if (type.IsArray) return type.GetElementType();
            return type.IsGenericType && type.GetGenericTypeDefinition() == typeof(List<>) ? type.GetGenericArguments()[0] : null;
        }

        private static IEnumerable<FieldInfo> Fields(Type type)
        {
            var above = type.BaseType == null || type.BaseType == typeof(object) ? Enumerable.Empty<FieldInfo>() : Fields(type.BaseType);
            return above.Concat(type.GetFields(All | BindingFlags.DeclaredOnly).Where(IsSerialized));
        }

        private static bool IsSerialized(FieldInfo field)
        {
            if (field.IsNotSerialized || field.IsInitOnly) return false;
            return (field.IsPublic || field.IsDefined(typeof(SerializeField), false)) && IsSerialized(ElementOf(field.FieldType) ?? field.FieldType);
        }

        private static bool IsSerialized(Type type)
        {
            return type == typeof(string) || type.IsPrimitive || type.IsEnum || (type.IsSerializable && !type.IsAbstract && !type.IsGenericType);
        }

        private static IEnumerable<Action<StringBuilder>> Elements(object value, Type type)
        {
            return ((IEnumerable)value ?? new object[0]).Cast<object>().Select<object, Action<StringBuilder>>(each => text => Write(each, ElementOf(type), text));
        }

        private static IEnumerable<Action<StringBuilder>> Members(object value, Type type)
        {
            return Fields(type).Select<FieldInfo, Action<StringBuilder>>(field => text =>
            {
                Quote(field.Name, text);
                text.Append(':');
                Write(field.GetValue(value ?? New(type)), field.FieldType, text);
            });
        }

        private static void WriteAll(char first, char last, IEnumerable<Action<StringBuilder>> parts, StringBuilder text)
        {
            text.Append(first);
            var isLater = false;
            foreach (var part in parts)
            {
                if (isLater) text.Append(',');
                part(text);
                isLater = true;
            }
            text.Append(last);
        }

        private static void Quote(string value, StringBuilder text)
        {
            text.Append('"');
            foreach (var letter in value)
            {
                if (letter == '"' || letter == '\\') text.Append('\\').Append(letter);
                else if (letter < ' ') text.Append("\\u").Append(((int)letter).ToString("x4"));
                else text.Append(letter);
            }
            text.Append('"');
        }
    }

    /// <summary>A number as it is written: of which kind it is, the field says.</summary>
    internal struct Number
    {
        private readonly string _text;

        public Number(string text)
        {
            _text = text;
        }

        public object As(Type type)
        {
            if (type.IsEnum) return Enum.ToObject(type, long.Parse(_text, CultureInfo.InvariantCulture));
            return System.Convert.ChangeType(_text, type, CultureInfo.InvariantCulture);
        }
    }

    /// <summary>Reads JSON. Throws ArgumentException, as Unity does.</summary>
    internal sealed class JsonText
    {
        private readonly string _text;
        private int _place;

        public JsonText(string text)
        {
            _text = text;
        }

        public object Whole()
        {
            var value = Value();
            if (Next() != '\0') throw Fault();
            return value;
        }

        private object Value()
        {
            switch (Next())
            {
                case '{': return Object();
                case '[': return List();
                case '"': return Text();
                case 't': return Word("true", true);
                case 'f': return Word("false", false);
                case 'n': return Word("null", null);
                default: return Digits();
            }
        }

        private Dictionary<string, object> Object()
        {
            var found = new Dictionary<string, object>();
            Each('}', () =>
            {
                if (Next() != '"') throw Fault();
                var name = Text();
                Take(':');
                found[name] = Value();
            });
            return found;
        }

        private List<object> List()
        {
            var found = new List<object>();
            Each(']', () => found.Add(Value()));
            return found;
        }

        private void Each(char last, Action read)
        {
            _place++;
            if (Next() != last)
            {
                read();
                while (Next() == ',')
                {
                    _place++;
                    read();
                }
            }
            Take(last);
        }

        private string Text()
        {
            var text = new StringBuilder();
            for (_place++; At() != '"'; _place++) text.Append(At() == '\\' ? Escaped() : At());
            _place++;
            return text.ToString();
        }

        private char Escaped()
        {
            _place++;
            if (At() == 'u')
            {
                _place += 4;
                return (char)int.Parse(_text.Substring(_place - 3, 4), NumberStyles.AllowHexSpecifier, CultureInfo.InvariantCulture);
            }
            var place = "bfnrt".IndexOf(At());
            return place < 0 ? At() : "\b\f\n\r\t"[place];
        }

        private object Word(string word, object value)
        {
            if (string.CompareOrdinal(_text, _place, word, 0, word.Length) != 0) throw Fault();
            _place += word.Length;
            return value;
        }

        private object Digits()
        {
            var start = _place;
            while (_place < _text.Length && "+-.0123456789eE".IndexOf(_text[_place]) >= 0) _place++;
            if (_place == start) throw Fault();
            return new Number(_text.Substring(start, _place - start));
        }

        private void Take(char wanted)
        {
            if (Next() != wanted) throw Fault();
            _place++;
        }

        /// <summary>The next letter that is no space, without taking it; 0 at the end.</summary>
        private char Next()
        {
            while (_place < _text.Length && char.IsWhiteSpace(_text[_place])) _place++;
            return _place < _text.Length ? _text[_place] : '\0';
        }

        private char At() => _place < _text.Length ? _text[_place] : throw Fault();

        private ArgumentException Fault() => new ArgumentException($"JSON parse error at letter {_place}");
    }
}
