#!/usr/bin/env python3
"""Writes the structs, enums and functions of oceanxl.h into oceanxl.py, between its two marks.

    python3 python/generate.py          rewrites oceanxl.py
    python3 python/generate.py check    fails when oceanxl.py does not match the header
    python3 python/generate.py sizes    prints a C program that compiles where C's structs have the sizes of ctypes'

It reads the header as clang-format leaves it: typedef struct NAME { ... } NAME, typedef enum, enum, OXL_API functions.
"""
import json
import pathlib
import re
import sys
import textwrap

HERE = pathlib.Path(__file__).resolve().parent
BEGIN, END = "# ---- generated from oceanxl.h", "# ---- end of what is generated\n"
BASIC = {"int": "c_int", "float": "c_float", "double": "c_double", "size_t": "c_size_t", "uint8_t": "c_uint8", "uint64_t": "c_uint64",
         "char": "c_char"}


class Header:
    def __init__(self, text):
        text = re.sub(r"/\*.*?\*/", "", text, flags=re.S)
        self.constants = re.findall(r'^#define (OXL_\w+) ([\d.]+|".*?")$', text, flags=re.M)
        text = re.sub(r"^#.*(\\\n.*)*$", "", text, flags=re.M)
        self.enums, self.structs, self.functions = {}, {}, {}
        for name, body in re.findall(r"\benum (\w*) ?\{(.*?)\}", text, flags=re.S):
            self.enums[name or "planes"] = self.members(body)
        structs = re.findall(r"typedef struct (\w+) \{(.*?)\n\} \w+;", text, flags=re.S)
        self.known = {name for name, _ in structs}
        self.choices = {}
        for name, body in structs:
            self.structs[name] = [f for line in body.split(";") if line.strip() for f in self.fields(name, " ".join(line.split()))]
        for result, name, arguments in re.findall(r"^OXL_API ([\w ]+?[ *]+)(oxl_\w+)\((.*?)\);", text, flags=re.M | re.S):
            if "..." not in arguments:
                self.functions[name] = (self.type(result), [] if arguments == "void" else self.arguments(arguments))

    def members(self, body):
        value, found = -1, {}
        for item in body.split(","):
            name, _, given = item.partition("=")
            if name.strip():
                value = int(given) if given.strip() else value + 1
                found[name.strip()] = value
        return found

    def type(self, text):
        """The ctypes name of a C type such as `const float *`."""
        stars = text.count("*")
        word = text.replace("*", " ").replace("const ", "").replace("struct ", "").strip()
        if word.startswith("enum ") or word in self.enums:
            word = "int"
        if stars and word == "char":
            base, stars = "c_char_p", stars - 1
        elif stars and word not in BASIC and word not in self.known:  # void, and what the header does not lay open
            base, stars = "c_void_p", stars - 1
        else:
            base = BASIC.get(word, None if word == "void" else word)
        for _ in range(stars):
            base = f"POINTER({base})"
        return base

    def arguments(self, text):
        types = []
        for argument in text.split(","):
            kind, name, array = re.fullmatch(r"(.*?)(\w+)((?:\[\w+\])*)", " ".join(argument.split())).groups()
            types.append(self.type(kind + ("*" if array else "")))
        return types

    def fields(self, struct, line):
        pointer = re.fullmatch(r"(.*?)\(\*(\w+)\)\((.*)\)", line)
        if pointer:
            result, name, arguments = pointer.groups()
            yield name, f"CFUNCTYPE({', '.join([str(self.type(result))] + self.arguments(arguments))})"
            return
        kind, rest = re.fullmatch(r"((?:const |struct |enum )*\w+ )(.*)", line).groups()
        for item in rest.split(","):
            stars, name, size = re.fullmatch(r" ?(\**)(\w+)(?:\[(\w+)\])?", item).groups()
            word = kind.split()[-1]
            if word in self.enums and not stars:
                self.choices[f"{struct}.{name}"] = word
            yield name, self.type(kind + stars) + (f" * {size}" if size else "")

    def python(self):
        yield f"{BEGIN} by generate.py: do not edit"
        constants = {name: value for members in self.enums.values() for name, value in members.items()}
        constants.update((name, json.loads(value)) for name, value in self.constants)
        yield f"globals().update({constants})"
        words = {name: {self.word(m, members): v for m, v in members.items()} for name, members in self.enums.items() if name != "planes"}
        yield f"WORDS = {words}"
        yield f"CHOICES = {self.choices}"
        yield f"globals().update((name, type(name, (Structure,), {{}})) for name in {tuple(self.structs)})"
        for name, fields in self.structs.items():
            yield f"{name}._fields_ = [{', '.join(f'({chr(34)}{n}{chr(34)}, {t})' for n, t in fields)}]"
        calls = (f"{chr(34)}{n}{chr(34)}: [{', '.join([str(result)] + arguments)}]" for n, (result, arguments) in self.functions.items())
        yield f"FUNCTIONS = {{{', '.join(calls)}}}"
        yield END.rstrip()

    @staticmethod
    def word(member, members):
        """OXL_DOG_SELECTIVE is "selective": the name without what all members begin with."""
        parts = [m.split("_") for m in members]
        common = 0
        while all(len(p) > common + 1 and p[common] == parts[0][common] for p in parts):
            common += 1
        return "_".join(member.split("_")[common:]).lower()

    def text(self):
        lines = [piece for line in self.python() for piece in textwrap.wrap(line, 140, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)]
        return "\n".join(lines) + "\n"


def sizes(header):
    sys.path.insert(0, str(HERE))
    import ctypes

    import oceanxl
    yield '#include "oceanxl.h"'
    for name, fields in header.structs.items():
        struct = getattr(oceanxl, name)
        wanted = [(f"sizeof({name})", ctypes.sizeof(struct))]
        wanted += [(f"offsetof({name}, {n})", getattr(struct, n).offset) for n, _ in fields]
        condition = " && ".join(f"{c} == {n}" for c, n in wanted)
        yield f"typedef char same_{name}[({condition}) ? 1 : -1];"


def main():
    header, target = Header((HERE.parent / "oceanxl.h").read_text()), HERE / "oceanxl.py"
    if sys.argv[1:] == ["sizes"]:
        print("\n".join(sizes(header)))
        return
    old = target.read_text()
    start, end = old.index(BEGIN), old.index(END)
    new = old[:start] + header.text() + old[end + len(END):]
    if sys.argv[1:] == ["check"]:
        if new != old:
            sys.exit("python/oceanxl.py does not match oceanxl.h\nfix: python3 python/generate.py")
    elif new != old:
        target.write_text(new)


if __name__ == "__main__":
    main()
