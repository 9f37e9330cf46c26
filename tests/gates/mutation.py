"""Mutants of C and C++ sources, all of them compiled in at once, each behind a number (mutant_switch.h).

Reads the syntax tree of clang (``-ast-dump=json``), so that an operator is one that the compiler saw, with
the types that it has. Every place where a source can be changed is a `Site`; it has one mutant or more.
`switched` writes the source again with all of them: it does the same until the switch names a mutant.

Operators: arithmetic (another operator, one operand alone), bits and shifts, relations (border, opposite),
conditions (true, false), `&&` and `||` (the other one, one side alone), constants (one up, one down, zero),
named constants and sizes (one up, one down), signs and negations, counting the other way, compound
assignments (the opposite, a plain one), returned values, statements left out; in the place of a variable or a
member that is read its neighbour of the same type, in the place of an argument the next one.

Not changed: what the compiler must know (sizes of arrays, cases, template arguments, assertions at compile
time; a constant is changed where it is used), what stands inside a macro with arguments, and operands of fold
expressions.
"""

import json
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

Node = dict[str, Any]

A, B = "lpvg_a", "lpvg_b"
ARITHMETIC = {
    "+": ("a - b", "a", "b"),
    "-": ("a + b", "a", "b"),
    "*": ("a / b",),
    "/": ("a * b",),
    "%": ("a * b",),
    "&": ("a | b",),
    "|": ("a & b",),
    "^": ("a & b",),
    "<<": ("a >> b",),
    ">>": ("a << b",),
}
RELATIONS = {
    "<": ("a <= b", "a >= b"),
    "<=": ("a < b", "a > b"),
    ">": ("a >= b", "a <= b"),
    ">=": ("a > b", "a < b"),
    "==": ("a != b",),
    "!=": ("a == b",),
}
ASSIGNMENTS = {"+=": "-=", "-=": "+=", "*=": "/=", "/=": "*=", "|=": "&=", "&=": "|=", "^=": "&="}
ASSIGNMENTS |= {"<<=": ">>=", ">>=": "<<="}
FLOATS = {"float", "double", "long double"}
WIDTHS = ("char", "short", "int", "long", "long long")
INTEGERS = {"signed char", *WIDTHS, *(f"unsigned {w}" for w in WIDTHS), "__uint128_t"}
UNSEEN = {
    "StaticAssertDecl",
    "ConstantExpr",
    "UnaryExprOrTypeTraitExpr",
    "OffsetOfExpr",
    "CXXDefaultArgExpr",
    "CXXDefaultInitExpr",
    "FullComment",
    "EnumDecl",
    "FieldDecl",
    "ParmVarDecl",
    "NonTypeTemplateParmDecl",
    "TemplateTypeParmDecl",
    "TemplateArgument",
    "VarTemplateDecl",
}
"""Kinds of nodes below which nothing is changed."""
THROUGH = {"ImplicitCastExpr", "ExprWithCleanups", "MaterializeTemporaryExpr", "CXXBindTemporaryExpr"}
FUNCTIONS = {"FunctionDecl", "CXXMethodDecl", "CXXConstructorDecl", "CXXConversionDecl"}
NAMED = {"VarDecl", "VarTemplateSpecializationDecl"}
NO_CONSTANT = {"NAN", "INFINITY", "NULL", "true", "false", "nullptr"}
STATEMENT, RETURN, CONDITION, ARGUMENT, EXPRESSION = range(5)
"""Of sites with the same text the one of lower rank lies around the others."""


@dataclass(frozen=True)
class Change:
    """What a mutant does to the lines that hold its site; white space is one space, comments are gone."""

    was: str
    becomes: str

    def __str__(self) -> str:
        return f"{self.was}  ->  {self.becomes or '(left out)'}"


@dataclass(frozen=True)
class Site:
    """Text from ``start`` to ``end`` of a file, with what stands before and behind it when switched; ``{n}``
    is its number, that of its first mutant. ``token``: an operator in it, and what stands in its place."""

    function: str
    line: int
    start: int
    end: int
    rank: int
    before: str
    behind: str
    token: tuple[int, int, str] | None
    changes: tuple[Change, ...]


@dataclass
class Sites:
    """Of one file; ``constexpr`` are the places of that word where it has to be ``const``."""

    sites: list[Site] = field(default_factory=list)
    constexpr: set[int] = field(default_factory=set)


def documents(dump: str) -> list[Node]:
    """Trees of a dump, every location with its file: clang names a file only where it changes."""
    decoder, at, nodes = json.JSONDecoder(), 0, []
    while (at := dump.find("{", at)) >= 0:
        node, at = decoder.raw_decode(dump, at)
        nodes.append(node)
    newest = ""

    def name(value: Any) -> None:
        nonlocal newest
        if isinstance(value, dict):
            if "offset" in value and "tokLen" in value:
                newest = value["file"] = value.get("file", newest)
            for key, part in value.items():
                if key != "includedFrom" and isinstance(part, dict | list):
                    name(part)
        elif isinstance(value, list):
            for part in value:
                name(part)

    name(nodes)
    return nodes


def plain_type(node: Node) -> str:
    kind = node.get("type", {})
    text = kind.get("desugaredQualType", kind.get("qualType", ""))
    return re.sub(r"\b(const|volatile)\b", "", text).strip()


def is_number(node: Node) -> bool:
    return plain_type(node) in FLOATS | INTEGERS


def value_type(node: Node) -> str:
    """Plain type of what a name stands for: a reference's is that of its object."""
    return plain_type(node).rstrip("& ")


def is_dependent(node: Node) -> bool:
    return "dependent" in plain_type(node)


def core(node: Node) -> Node:
    """The node below conversions that no text says."""
    while node.get("kind") in THROUGH and node.get("inner"):
        node = node["inner"][0]
    return node


class Finder:
    """Collects the sites of the files in ``texts`` (by absolute path) from trees of one compilation."""

    def __init__(self, texts: dict[str, str]) -> None:
        self.texts = texts
        self.found: dict[str, Sites] = {path: Sites() for path in texts}
        self.constants: set[str] = set()  # names at file scope
        self.constant_ids: set[str] = set()
        self.folds: list[tuple[str, int, int]] = []
        self.fields: dict[str, list[tuple[str, str]]] = {}  # name and type, by record
        self.scopes: list[list[tuple[str, str]]] = []  # name and type of what has a value, innermost last
        self.function = ""
        self.outside = False  # of every function
        self.visitors: dict[str, Callable[[Node], None]] = {
            "BinaryOperator": self.binary,
            "CXXOperatorCallExpr": self.overloaded,
            "UnaryOperator": self.unary,
            "IntegerLiteral": self.literal,
            "FloatingLiteral": self.literal,
            "CXXBoolLiteralExpr": self.truth,
            "DeclRefExpr": self.named,
            "SubstNonTypeTemplateParmExpr": self.named,
            "ConditionalOperator": self.conditional,
            "IfStmt": self.if_,
            "WhileStmt": self.while_,
            "DoStmt": self.do,
            "ForStmt": self.for_,
            "CXXForRangeStmt": lambda node: self.body(node["inner"][-1]),
            "CompoundStmt": self.compound_statement,
            "CaseStmt": lambda node: self.body(node["inner"][-1]),
            "DefaultStmt": lambda node: self.body(node["inner"][-1]),
            "SwitchStmt": lambda node: self.visit(node["inner"][-1]),
            "ReturnStmt": self.return_,
            "VarDecl": self.variable,
            "ImplicitCastExpr": self.read_value,
            "CallExpr": self.call,
        }

    # --- places in the text ---

    def place(self, at: Node) -> tuple[str, int, int, bool]:
        """File, first offset, offset behind the token, whether a macro made it; file "": none."""
        macro = "expansionLoc" in at
        at = at.get("expansionLoc", at)
        if at.get("file") not in self.texts or "offset" not in at:
            return "", 0, 0, False
        return at["file"], at["offset"], at["offset"] + at["tokLen"], macro

    def span(self, node: Node) -> tuple[str, int, int] | None:
        """File and text of a node; None where it is not written in one of the files, or inside a macro's
        arguments or text."""
        limits = node.get("range", {})
        file, start, stop, from_macro = self.place(limits.get("begin", {}))
        other, begin_of_last, end, to_macro = self.place(limits.get("end", {}))
        if not file or other != file:
            return None
        takes = self.texts[file][end:].lstrip().startswith("(")
        if from_macro and to_macro and start == begin_of_last:
            return None if takes else (file, start, stop)
        if to_macro and takes:
            depth, end = 1, self.texts[file].index("(", end) + 1
            while depth:
                depth += {"(": 1, ")": -1}.get(self.texts[file][end], 0)
                end += 1
        return (file, start, end) if start < end else None

    def in_macro(self, node: Node) -> bool:
        """Whether one macro, however long, makes all of the node."""
        begin, end = node.get("range", {}).get("begin", {}), node.get("range", {}).get("end", {})
        first, last = begin.get("expansionLoc"), end.get("expansionLoc")
        return bool(first and last and first.get("offset") == last.get("offset"))

    def operator(self, left: Node, right: Node, sign: str) -> tuple[int, int] | None:
        """Where the operator between two operands stands."""
        a, b = self.span(left), self.span(right)
        if a is None or b is None or a[0] != b[0]:
            return None
        between = self.texts[a[0]][a[2] : b[1]]
        if re.sub(r"//[^\n]*", "", between).strip() != sign:
            return None
        at = a[2] + re.sub(r"//[^\n]*", lambda m: " " * len(m[0]), between).index(sign)
        return at, at + len(sign)

    def change(self, file: str, start: int, end: int, new: str) -> Change:
        text = self.texts[file]
        first = text.rfind("\n", 0, start) + 1
        last = text.find("\n", end)

        def tidy(code: str) -> str:
            return " ".join(re.sub(r"//[^\n]*", "", code).split())

        return Change(tidy(text[first:last]), tidy(text[first:start] + new + text[end:last]))

    def add(
        self,
        node: Node,
        rank: int,
        before: str,
        behind: str,
        edits: list[tuple[int, int, str]],
        token: tuple[int, int, str] | None = None,
    ) -> None:
        """A site around a node; one mutant for each edit (start, end, new text)."""
        place = self.span(node)
        if place is None or not self.function:
            return
        file, start, end = place
        line = self.texts[file].count("\n", 0, start) + 1
        changes = tuple(self.change(file, *edit) for edit in edits)
        self.found[file].sites.append(
            Site(self.function, line, start, end, rank, before, behind, token, changes)
        )

    def text(self, node: Node) -> str:
        place = self.span(node)
        return self.texts[place[0]][place[1] : place[2]] if place else ""

    # --- walking ---

    def collect(self, trees: list[Node]) -> None:
        """Names of constants, and fold expressions: before anything is changed."""

        def look(node: Node, outside: bool) -> None:
            kind = node.get("kind")
            if kind == "CXXFoldExpr":
                place = self.span(node)
                self.folds += [place] if place else []
            if kind in NAMED and node.get("constexpr") and is_number(node):
                self.constant_ids.add(node.get("id", ""))
                if outside:
                    self.constants.add(node.get("name", ""))
            if kind in ("RecordDecl", "CXXRecordDecl") and node.get("name"):
                parts = [n for n in node.get("inner", []) if n.get("kind") == "FieldDecl" and n.get("name")]
                if parts:
                    self.fields[node["name"]] = [(n["name"], plain_type(n)) for n in parts]
            for inner in node.get("inner", []):
                look(inner, outside and kind not in FUNCTIONS)

        for tree in trees:
            look(tree, True)

    def walk(self, trees: list[Node]) -> dict[str, Sites]:
        for tree in trees:
            self.visit(tree)
        for file, sites in self.found.items():
            sites.sites = [s for s in sites.sites if not self.in_fold(file, s)]
        return self.found

    def in_fold(self, file: str, site: Site) -> bool:
        """Whether a site is a part of a fold expression; as a statement it may be left out."""
        return any(
            f == file and start <= site.start and site.end <= end
            for f, start, end in self.folds
            if site.rank != STATEMENT or (site.start, site.end) != (start, end)
        )

    def visit(self, node: Node) -> None:
        kind = node.get("kind", "")
        if kind in UNSEEN or node.get("isImplicit"):
            return
        if kind in FUNCTIONS:
            self.function_(node)
        elif kind.endswith(("Expr", "Operator", "Literal")) and self.in_macro(node):
            self.macro(node)
        elif kind in self.visitors:
            self.visitors[kind](node)
        else:
            self.children(node)

    def children(self, node: Node) -> None:
        for inner in node.get("inner", []):
            self.visit(inner)

    def function_(self, node: Node) -> None:
        file, start, end, _ = self.place(node.get("loc", {}))
        outer, scopes = self.function, self.scopes
        if not outer:  # a lambda counts to what it stands in
            self.function = self.texts[file][start:end] if file else ""
        if self.function:
            parameters = [
                n for n in node.get("inner", []) if n.get("kind") == "ParmVarDecl" and n.get("name")
            ]
            self.scopes = [[(n["name"], value_type(n)) for n in parameters]]
            self.children(node)
        self.function, self.scopes = outer, scopes

    def body(self, node: Node) -> None:
        """A statement whose value nobody takes."""
        kind = node.get("kind", "")
        inside = core(node)
        value = inside.get("kind", "").endswith(("Expr", "Operator"))
        if (
            value
            or (kind == "ReturnStmt" and not node.get("inner"))
            or kind == "ContinueStmt"
            or (kind == "BreakStmt" and not self.is_last(node))
        ):
            place = self.span(node)
            if place:
                _, start, end = place
                self.add(node, STATEMENT, "if (!LPVG_IS({n}, 0)) ", "", [(start, end, "")])
        if inside.get("kind") == "CompoundAssignOperator":
            self.assignment(inside, inside["opcode"], *inside["inner"])
        elif inside.get("kind") == "CXXOperatorCallExpr" and len(inside["inner"]) == 3:
            sign = core(inside["inner"][0]).get("referencedDecl", {}).get("name", "")[len("operator") :]
            if sign in ("+=", "-="):
                self.assignment(inside, sign, *inside["inner"][1:])
        self.visit(node)

    def is_last(self, node: Node) -> bool:
        """Whether only ends of blocks follow up to the function's."""
        place = self.span(node)
        rest = self.texts[place[0]][place[2] :] if place else ""
        return bool(re.match(r";(\s*\})+\s*(\n\S|$)", rest))

    def compound_statement(self, node: Node) -> None:
        self.scopes.append([])
        for inner in node.get("inner", []):
            self.body(inner)
        self.scopes.pop()

    # --- statements ---

    def condition(self, node: Node, both: bool = True) -> None:
        place = self.span(core(node))
        if place and not is_dependent(node):
            edits = [(place[1], place[2], "true")] if both else []
            edits.append((place[1], place[2], "false"))
            name = "LPVG_CONDITION" if both else "LPVG_WHILE"
            self.add(core(node), CONDITION, name + "({n}, (", "))", edits)
        self.visit(node)

    def if_(self, node: Node) -> None:
        inner = node["inner"]
        if node.get("isConstexpr"):
            self.visit_bodies(inner[1:])
            return
        assert not node.get("hasInit") and not node.get("hasVar"), "a condition that declares"
        self.condition(inner[0])
        self.visit_bodies(inner[1:])

    def visit_bodies(self, nodes: list[Node]) -> None:
        for node in nodes:
            self.body(node)

    def while_(self, node: Node) -> None:
        self.condition(node["inner"][0], both=False)
        self.body(node["inner"][-1])

    def do(self, node: Node) -> None:
        self.body(node["inner"][0])
        self.condition(node["inner"][-1], both=False)

    def for_(self, node: Node) -> None:
        init, _, test, step, body = node["inner"]
        self.scopes.append([])
        self.visit(init)
        self.visit(test)
        self.visit(step)
        self.body(body)
        self.scopes.pop()

    def conditional(self, node: Node) -> None:
        self.condition(node["inner"][0])
        for inner in node["inner"][1:]:
            self.visit(inner)

    def return_(self, node: Node) -> None:
        if node.get("inner"):
            top = node["inner"][0]
            value = core(top)
            new = [] if top.get("valueCategory") == "lvalue" else self.returned(value)
            place = self.span(value)
            if new and place:
                edits = [(place[1], place[2], text.format(self.text(value))) for _, text in new]
                exprs = ", ".join([A, *(expr for expr, _ in new)])
                self.add(value, RETURN, f"LPVG_ONE{len(new)}({{n}}, {exprs}, (", "))", edits)
        self.children(node)

    def returned(self, value: Node) -> list[tuple[str, str]]:
        """Other values to return: expression, and how a reader would write it."""
        kind, sort = value.get("kind", ""), plain_type(value)
        simple = kind.endswith("Literal") or value.get("opcode") in ("&&", "||", "!", *RELATIONS)
        if simple or kind == "CXXBoolLiteralExpr" or is_dependent(value):
            return []
        same = f"(__typeof__({A}))"
        if sort == "bool":
            return [(f"!{A}", "!({})")]
        if sort in FLOATS:
            return [(f"{same}({A} == 0 ? 1 : 0)", "0"), (f"-{A}", "-({})")]
        if sort in INTEGERS:
            return [(f"{same}({A} == 0 ? 1 : 0)", "0"), (f"{same}({A} + 1)", "{} + 1")]
        if value.get("referencedDecl", {}).get("kind") == "EnumConstantDecl":
            return [(f"{same}({A} == 0 ? 1 : 0)", "another enumerator than {}")]
        if sort.endswith("*"):
            return [(f"{same}0", "nullptr")]
        return []

    def variable(self, node: Node) -> None:
        outside = not self.function
        if node.get("constexpr"):
            if is_number(node) or is_dependent(node):
                return
            file, start, _, _ = self.place(node["range"]["begin"])
            place = self.place(node["loc"])
            if file:
                word = self.texts[file].find("constexpr", start, place[1])
                self.found[file].constexpr |= {word} if word >= 0 else set()
        elif outside:
            return  # of C, where it must be known to the compiler
        name = self.function
        self.function = name or node.get("name", "")
        self.outside = outside
        self.children(node)
        self.function, self.outside = name, False
        if self.scopes and node.get("init") and not node.get("constexpr"):
            self.scopes[-1].append((node.get("name", ""), value_type(node)))

    # --- expressions ---

    def read_value(self, node: Node) -> None:
        """A variable or a member that is read: its neighbour of the same type."""
        inside = node["inner"][0]
        if node.get("castKind") == "LValueToRValue" and is_number(inside):
            other = ""
            if inside["kind"] == "DeclRefExpr":
                other = self.neighbour(inside)
            elif inside["kind"] == "MemberExpr":
                other = self.other_member(inside)
            if other:
                self.replaced(inside, EXPRESSION, other)
        self.children(node)

    def replaced(self, node: Node, rank: int, other: str) -> None:
        place = self.span(node)
        if place:
            before = f"LPVG_ONE1({{n}}, {A}, (__typeof__({A}))({other}), ("
            self.add(node, rank, before, "))", [(place[1], place[2], other)])

    def neighbour(self, node: Node) -> str:
        """The variable of a local variable's type that was declared last before the place, or ""."""
        known = [variable for scope in self.scopes for variable in scope]
        own = (node.get("referencedDecl", {}).get("name", ""), plain_type(node))
        if own not in known or self.text(node) != own[0]:
            return ""
        return next((name for name, sort in reversed(known) if sort == own[1] and name != own[0]), "")

    def other_member(self, node: Node) -> str:
        """The same text with the record's next member of the same type, or ""."""
        record = re.sub(r"^(struct|class) ", "", value_type(node["inner"][0]).rstrip("* ")).split("::")[-1]
        text, name, sort = self.text(node), node.get("name", ""), plain_type(node)
        same = [n for n, s in self.fields.get(record, []) if s == sort]
        if name not in same or len(same) < 2 or not text.endswith(name) or "(" in text:
            return ""
        return text[: -len(name)] + same[(same.index(name) + 1) % len(same)]

    def call(self, node: Node) -> None:
        """Each argument that is a number: the next of its type, where it has no effects."""
        arguments = node["inner"][1:]
        for one, two in pairwise(arguments):
            text = self.text(core(two))
            same = is_number(one) and plain_type(one) == plain_type(two) and text != self.text(core(one))
            if same and one.get("valueCategory") == "prvalue" and re.fullmatch(r"[\w.>\[\]-]+", text):
                self.replaced(core(one), ARGUMENT, text)
        self.children(node)

    def binary(self, node: Node) -> None:
        left, right = node["inner"]
        sign = node["opcode"]
        at = self.operator(left, right, sign)
        if at and sign in ("&&", "||"):
            self.logical(node, left, right, sign, at)
        elif at and sign in ARITHMETIC | RELATIONS and not any(map(is_dependent, (node, left, right))):
            new = (ARITHMETIC | RELATIONS)[sign]
            if not is_number(right) and sign not in RELATIONS:  # a difference of pointers
                new = ()
            elif not is_number(left) and sign not in RELATIONS:
                new = new[:1]
            self.switched_operator(node, left, right, at, sign, new)
        self.children(node)

    def switched_operator(
        self, node: Node, left: Node, right: Node, at: tuple[int, int], sign: str, new: tuple[str, ...]
    ) -> None:
        place, a, b = self.span(node), self.span(left), self.span(right)
        if not new or place is None or a is None or b is None:
            return
        edits = []
        for text in new:
            if text in ("a", "b"):
                kept = a if text == "a" else b
                edits.append((place[1], place[2], self.texts[kept[0]][kept[1] : kept[2]]))
            else:
                edits.append((*at, text.split()[1]))
        exprs = [f"a {sign} b", *new]
        written = ", ".join(re.sub(r"\b[ab]\b", lambda m: A if m[0] == "a" else B, e) for e in exprs)
        self.add(node, EXPRESSION, f"LPVG_TWO{len(new)}({{n}}, {written}, (", "))", edits, (*at, "), ("))

    def logical(self, node: Node, left: Node, right: Node, sign: str, at: tuple[int, int]) -> None:
        place = self.span(node)
        if place is None:
            return
        other, name = ("||", "AND") if sign == "&&" else ("&&", "OR")
        edits = [(*at, other), (place[1], place[2], self.text(left)), (place[1], place[2], self.text(right))]
        self.add(node, EXPRESSION, f"LPVG_{name}({{n}}, (", "))", edits, (*at, "), ("))

    def assignment(self, node: Node, sign: str, left: Node, right: Node) -> None:
        """A compound assignment that is a statement."""
        at = self.operator(left, right, sign)
        if at is None or is_dependent(left) or is_dependent(right):
            return
        simple = is_number(left) or plain_type(left) == "bool"
        new = [ASSIGNMENTS[sign], "="] if simple else [ASSIGNMENTS[sign]]
        signs = ", ".join([sign, *new])
        name = f"LPVG_ASSIGN{len(new)}({{n}}, {signs}, ("
        self.add(node, EXPRESSION, name, "))", [(*at, text) for text in new], (*at, "), ("))

    def overloaded(self, node: Node) -> None:
        """Sums and differences of Eigen's expressions, and of structs."""
        if len(node["inner"]) == 3:
            callee, left, right = node["inner"]
            sign = core(callee).get("referencedDecl", {}).get("name", "")[len("operator") :]
            at = self.operator(left, right, sign) if sign in ("+", "-") else None
            if at and not is_dependent(node):
                other = "-" if sign == "+" else "+"
                if "Complex" not in plain_type(node):
                    before = f"LPVG_EIGEN({{n}}, {sign}, {other}, ("
                    self.add(node, EXPRESSION, before, "))", [(*at, other)], (*at, "), ("))
                else:
                    self.switched_operator(node, left, right, at, sign, (f"a {other} b",))
        self.children(node)

    def unary(self, node: Node) -> None:
        place, inner = self.span(node), node["inner"][0]
        sign, a = node["opcode"], self.span(node["inner"][0])
        if place is not None and a is not None and not is_dependent(inner):
            start, end = place[1], place[2]
            rest = self.text(inner)
            if sign == "!":
                self.add(node, EXPRESSION, "(LPVG_IS({n}, 0) != ", ")", [(start, end, rest)])
            elif sign in ("-", "~") and core(inner).get("kind") not in ("IntegerLiteral", "FloatingLiteral"):
                before = f"LPVG_ONE1({{n}}, {sign}{A}, {A}, ("
                self.add(node, EXPRESSION, before, "))", [(start, end, rest)], (start, start + 1, " "))
            elif sign in ("++", "--"):
                self.count(node, sign, start, end, rest)
        self.children(node)

    def count(self, node: Node, sign: str, start: int, end: int, rest: str) -> None:
        other = "--" if sign == "++" else "++"
        if node.get("isPostfix"):
            before, token, new = f"LPVG_POSTFIX({{n}}, {sign}, {other}, (", (end - 2, end, ""), rest + other
        else:
            before, token, new = (
                f"LPVG_PREFIX({{n}}, {sign}, {other}, (",
                (start, start + 2, ""),
                other + rest,
            )
        self.add(node, EXPRESSION, before, "))", [(start, end, new)], token)

    def constant(self, node: Node, new: list[tuple[str, str]]) -> None:
        place = self.span(node)
        if place:
            exprs = ", ".join([A, *(f"(__typeof__({A}))({expr})" for expr, _ in new)])
            edits = [(place[1], place[2], text) for _, text in new]
            name = "LPVG_MADE" if self.outside else "LPVG_ONE"
            self.add(node, EXPRESSION, f"{name}{len(new)}({{n}}, {exprs}, (", "))", edits)

    def literal(self, node: Node) -> None:
        text = self.text(node)
        digits = re.fullmatch(r"([0-9a-fA-FxX'.+-]+?)([uUlLfF]*)", text)
        value = float(node["value"])
        suffix = "" if digits is None or (text.lower().startswith("0x")) else digits[2]
        point = ".0" if node["kind"] == "FloatingLiteral" else ""

        def said(number: float) -> str:
            return f"{number:g}{suffix}" if point else f"{int(number)}{suffix}"

        new = [(f"{A} + 1", said(value + 1))]
        new += [(f"{A} - 1", said(value - 1))] if value != 0 or point else []
        new += [("0", said(0))] if value not in (0, 1) else []
        self.constant(node, new)

    def truth(self, node: Node) -> None:
        place = self.span(node)
        if place:
            other = "false" if self.text(node) == "true" else "true"
            self.add(node, EXPRESSION, "(LPVG_IS({n}, 0) != ", ")", [(place[1], place[2], other)])

    def named(self, node: Node) -> None:
        """A constant, or a template's size, by its name."""
        declared = node.get("referencedDecl", {})
        known = declared.get("id") in self.constant_ids or declared.get("name") in self.constants
        if is_number(node) and (
            node["kind"] == "SubstNonTypeTemplateParmExpr" or (declared.get("kind") in NAMED and known)
        ):
            name = self.text(node)
            self.constant(node, [(f"{A} + 1", f"({name} + 1)"), (f"{A} - 1", f"({name} - 1)")])

    def macro(self, node: Node) -> None:
        """What one macro makes: a number by its name."""
        inside = core(node)
        name = self.text(inside)
        if name and name not in NO_CONSTANT and is_number(inside):
            self.constant(inside, [(f"{A} + 1", f"({name} + 1)"), (f"{A} - 1", f"({name} - 1)")])


def sites_of(dump: str, texts: dict[str, str]) -> dict[str, Sites]:
    """Sites in the files of ``texts`` (absolute path -> text) by the dumped trees of a compilation."""
    sys.setrecursionlimit(10_000)  # a long condition is a deep tree
    trees = documents(dump)
    finder = Finder(texts)
    finder.collect(trees)
    return finder.walk(trees)


def merged(several: list[Sites]) -> Sites:
    """Sites of a file that several compilations saw, in the order of the text."""
    chosen: dict[tuple[int, int, int], Site] = {}
    for sites in several:
        for site in sites.sites:
            key = (site.start, -site.end, site.rank)
            if key not in chosen or len(site.changes) > len(chosen[key].changes):
                chosen[key] = site
    return Sites([chosen[key] for key in sorted(chosen)], {at for s in several for at in s.constexpr})


def numbered(sites: Sites, first: int) -> Iterator[tuple[int, Site]]:
    """Every site with its number; its mutants have this one and the next."""
    for site in sites.sites:
        yield first, site
        first += len(site.changes)


def switched(text: str, sites: Sites, first: int) -> str:
    """The source with all mutants behind the switch."""
    pieces: list[tuple[int, int, tuple[int, int], int, str]] = []
    for number, site in numbered(sites, first):
        # At one place what ends comes before what begins; the inner one ends first, the outer begins first.
        pieces.append((site.start, 1, (-site.end, site.rank), 0, site.before.replace("{n}", str(number))))
        pieces.append((site.end, 0, (-site.start, -site.rank), 0, site.behind))
        if site.token:
            start, end, new = site.token
            pieces.append((start, 1, (1, 0), end - start, new))
    pieces += [(at, 1, (1, 0), len("constexpr"), "const") for at in sites.constexpr]
    out, at = [], 0
    for place, _, _, length, new in sorted(pieces):
        out += [text[at:place], new]
        at = place + length
    return "".join([*out, text[at:]])


def read(path: Path) -> str:
    """Text whose characters are the bytes that clang counts."""
    return path.read_text(encoding="latin-1")
