#!/usr/bin/env python3
"""Writes the structs, enums and functions of oceanxl.h into oceanxl.py, between its two marks.

    python3 python/generate.py          rewrites oceanxl.py
    python3 python/generate.py check    fails when oceanxl.py does not match the header

It reads the header as clang-format leaves it: typedef struct NAME { ... } NAME, typedef enum, enum, OXL_API functions.
"""
import json
import os
import pathlib
import re
import sys
import textwrap

HERE = pathlib.Path(__file__).resolve().parent
BEGIN, END = "# ---- generated from oceanxl.h", "# ---- end of what is generated\n"
BASIC = {"uint8_t": "c_uint8", "uint64_t": "c_uint64", **{word: f"c_{word}" for word in ("int", "float", "double", "size_t", "char")}}


class Header:
    def __init__(self, text):
        text = re.sub(r"/\*.*?\*/", "", text, flags=re.S)
        self.constants = re.findall(r'^#define (OXL_\w+) ([\d.]+|".*?")$', text, flags=re.M)
        text = re.sub(r"^#.*(\\\n.*)*$", "", text, flags=re.M)
        self.enums = {name: self.members(body) for name, body in re.findall(r"\benum (\w*) ?\{(.*?)\}", text, flags=re.S)}
        structs = re.findall(r"typedef struct (\w+) \{(.*?)\n\} \w+;", text, flags=re.S)
        self.known, self.choices, self.functions = {name for name, _ in structs}, {}, {}
        self.structs = {name: [f for line in body.split(";") if line.strip() for f in self.fields(name, " ".join(line.split()))]
                        for name, body in structs}
        for result, name, arguments in re.findall(r"^OXL_API ([\w ]+?[ *]+)(oxl_\w+)\((.*?)\);", text, flags=re.M | re.S):
            if "..." not in arguments:
                self.functions[name] = self.signature(result, arguments)

    def members(self, body):
        value, found = -1, {}
        for name, given in re.findall(r"(\w+)(?: = (\d+))?", body):
            value = found[name] = int(given) if given else value + 1
        return found

    def type(self, text):
        """The ctypes name of a C type such as `const float *`."""
        stars, word = text.count("*"), re.sub(r"\*|\bconst\b|\bstruct\b", "", text).strip()
        if stars and word == "char":
            base, stars = "c_char_p", stars - 1
        elif stars and word not in BASIC and word not in self.known:  # void, and what the header does not lay open
            base, stars = "c_void_p", stars - 1
        else:
            base = "c_int" if word.removeprefix("enum ") in self.enums else BASIC.get(word, None if word == "void" else word)
        return "POINTER(" * stars + str(base) + ")" * stars

    def signature(self, result, arguments):
        types = [self.type(result)]
        for argument in [] if arguments == "void" else arguments.split(","):
            kind, array = re.fullmatch(r"(.*?)\w+((?:\[\w+\])*)", " ".join(argument.split())).groups()
            types.append(self.type(kind + ("*" if array else "")))
        return ", ".join(types)

    def fields(self, struct, line):
        pointer = re.fullmatch(r"(.*?)\(\*(\w+)\)\((.*)\)", line)
        if pointer:
            yield pointer[2], f"CFUNCTYPE({self.signature(pointer[1], pointer[3])})"
            return
        kind, rest = re.fullmatch(r"((?:const |struct |enum )*\w+ )(.*)", line).groups()
        for stars, name, size in re.findall(r"(\**)(\w+)(?:\[(\w+)\])?", rest):
            if kind.split()[-1] in self.enums and not stars:
                self.choices[f"{struct}.{name}"] = kind.split()[-1]
            yield name, self.type(kind + stars) + (f" * {size}" if size else "")

    def python(self):
        yield f"{BEGIN} by generate.py: do not edit"
        constants = {name: value for members in self.enums.values() for name, value in members.items()}
        constants.update((name, json.loads(value)) for name, value in self.constants)
        yield f"globals().update({constants})"
        # OXL_DOG_SELECTIVE is "selective": the name without what all members begin with.
        begins = {name: os.path.commonprefix(list(members)).rfind("_") + 1 for name, members in self.enums.items() if name}
        yield "WORDS = " + str({name: {m[at:].lower(): v for m, v in self.enums[name].items()} for name, at in begins.items()})
        yield f"CHOICES = {self.choices}"
        yield f"globals().update((name, type(name, (Structure,), {{}})) for name in {tuple(self.structs)})"
        for name, fields in self.structs.items():
            yield f"{name}._fields_ = [" + ", ".join(f'("{n}", {t})' for n, t in fields) + "]"
        yield "FUNCTIONS = {" + ", ".join(f'"{name}": [{types}]' for name, types in self.functions.items()) + "}"
        yield END.rstrip()

    def text(self):
        return "".join(textwrap.fill(line, 140, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False) + "\n"
                       for line in self.python())


def main():
    header, target = Header((HERE.parent / "oceanxl.h").read_text()), HERE / "oceanxl.py"
    old = target.read_text()
    start, end = old.index(BEGIN), old.index(END)
    new = old[:start] + header.text() + old[end + len(END):]
    if sys.argv[1:] != ["check"]:
        target.write_text(new)
    elif new != old:
        sys.exit("python/oceanxl.py does not match oceanxl.h\nfix: python3 python/generate.py")


if __name__ == "__main__":
    main()
