"""Mutants of Python sources, each a node of the syntax tree that another one replaces.

`Mutants` finds them in the functions of one module and can apply one in memory: `applied` gives the module's
code with it. No file is written again.

Operators: arithmetic (another operator; of a sum or difference one operand alone), comparisons (border,
opposite), conditions (true, false), ``and`` and ``or`` (the other one, one side alone), numbers and named
constants (one up, one down, zero), truth values, signs and negations, augmented assignments (the opposite, a
plain one), what has a counterpart (min and max, any and all, floor and ceil, sin and cos, real and
imaginary part), an operand in place of a call (absolute value, conjugate, square root, transposition), and
statements left out. A statement that only names something anew is left out only where the name had a value
before.

Not changed: code outside of functions, decorators, annotations, texts, and what a ``raise`` says.
"""

import ast
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from types import CodeType
from typing import cast

from mutation import Change

ARITHMETIC: dict[type[ast.operator], tuple[type[ast.operator], bool]] = {
    ast.Add: (ast.Sub, True),
    ast.Sub: (ast.Add, True),
    ast.Mult: (ast.Div, False),
    ast.Div: (ast.Mult, False),
    ast.FloorDiv: (ast.Mult, False),
    ast.Mod: (ast.Mult, False),
    ast.Pow: (ast.Mult, False),
    ast.MatMult: (ast.Mult, False),
    ast.BitAnd: (ast.BitOr, False),
    ast.BitOr: (ast.BitAnd, False),
    ast.LShift: (ast.RShift, False),
    ast.RShift: (ast.LShift, False),
}
"""Operator -> another one, and whether either operand may stand alone."""
RELATIONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
COUNTERPARTS = {
    "min": "max",
    "minimum": "maximum",
    "fmin": "fmax",
    "nanmin": "nanmax",
    "argmin": "argmax",
    "any": "all",
    "floor": "ceil",
    "sin": "cos",
    "real": "imag",
}
COUNTERPARTS |= {b: a for a, b in COUNTERPARTS.items()}
LEFT_OUT = {"abs", "conj", "sqrt", "transpose"}
"""Functions of one argument, and methods of none, in whose place their operand stands."""
BLOCKS = (ast.If, ast.For, ast.While, ast.With, ast.FunctionDef)
Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Place:
    """Where a node hangs in the tree."""

    parent: ast.AST
    field: str
    index: int | None

    def get(self) -> ast.AST:
        value = getattr(self.parent, self.field)
        return cast(ast.AST, value if self.index is None else value[self.index])

    def put(self, node: ast.AST) -> None:
        if self.index is None:
            setattr(self.parent, self.field, node)
        else:
            getattr(self.parent, self.field)[self.index] = node


@dataclass(frozen=True)
class Site:
    """A place of ``function``, the lines of the statement whose running reaches it, and what its mutants do:
    one for each of ``new``."""

    function: str
    first_line: int  # of the function, with its decorators
    default: str | None  # the parameter whose default it is
    line: int
    lines: range
    place: Place
    new: tuple[ast.AST, ...]
    changes: tuple[Change, ...]


def places(node: ast.AST) -> Iterator[Place]:
    for field, value in ast.iter_fields(node):
        if isinstance(value, ast.AST):
            yield Place(node, field, None)
        elif isinstance(value, list):
            yield from (Place(node, field, i) for i, item in enumerate(value) if isinstance(item, ast.AST))


def written(statement: ast.stmt) -> str:
    """A statement on one line; of a block its first line."""
    lines = ast.unparse(statement).split("\n")
    if isinstance(statement, Function):
        return next(line for line in lines if line.startswith(("def ", "async def ")))
    return lines[0] if isinstance(statement, BLOCKS) else " ".join(line.strip() for line in lines)


def lines_of(statement: ast.stmt) -> range:
    """Lines of a statement; of a block those of its head, of a function those of its body."""
    if isinstance(statement, Function):
        return range(statement.body[0].lineno, (statement.end_lineno or 0) + 1)
    if isinstance(statement, BLOCKS):
        return range(statement.lineno, max(statement.body[0].lineno, statement.lineno + 1))
    return range(statement.lineno, (statement.end_lineno or statement.lineno) + 1)


def is_number(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Constant)
        and isinstance(node.value, int | float)
        and not isinstance(node.value, bool)
    )


def targets(statement: ast.stmt) -> list[ast.expr]:
    """What a statement names."""
    if isinstance(statement, ast.Assign):
        assigned = statement.targets
    elif isinstance(statement, ast.AnnAssign | ast.AugAssign | ast.For):
        assigned = [statement.target]
    else:
        return []
    return [t for f in assigned for t in (f.elts if isinstance(f, ast.Tuple | ast.List) else [f])]


class Mutants:
    """Sites of a module's functions; ``constants`` are names of numbers that it knows from elsewhere."""

    def __init__(self, source: str, path: str, constants: Collection[str] = ()) -> None:
        self.tree = ast.parse(source, path)
        self.path = path
        self.constants = set(constants)
        self.sites: list[Site] = []
        self.function = ""
        self.first_line = 0
        self.default: str | None = None
        self.named: set[str] = set()  # what the function has named so far
        self.statement: ast.stmt = ast.Pass()
        self.visitors: dict[type[ast.AST], Callable[[ast.AST, Place], None]] = {
            ast.BinOp: self.binary,
            ast.Compare: self.compare,
            ast.BoolOp: self.logical,
            ast.UnaryOp: self.unary,
            ast.Constant: self.constant,
            ast.Name: self.name,
            ast.Attribute: self.attribute,
            ast.Call: self.call,
            ast.IfExp: self.conditional,
            ast.If: self.conditional,
            ast.While: self.conditional,
            ast.comprehension: self.comprehension,
            ast.AugAssign: self.augmented,
        }
        self.outside(self.tree, "")

    def applied(self, site: Site, index: int) -> CodeType:
        """Code of the module with one mutant, which the tree keeps."""
        old = site.place.get()
        new = site.new[index]
        site.place.put(ast.copy_location(new, old))
        ast.fix_missing_locations(self.tree)
        return compile(self.tree, self.path, "exec")

    # --- walking ---

    def outside(self, node: ast.AST, prefix: str) -> None:
        for inner in ast.iter_child_nodes(node):
            if isinstance(inner, ast.ClassDef):
                self.outside(inner, f"{prefix}{inner.name}.")
            elif isinstance(inner, Function):
                self.function = prefix + inner.name
                self.named = {a.arg for a in ast.walk(inner.args) if isinstance(a, ast.arg)}
                self.statement = inner
                self.first_line = min([inner.lineno, *(d.lineno for d in inner.decorator_list)])
                self.defaults(inner.args)
                self.body(inner)
                self.function = ""
            elif isinstance(inner, ast.If | ast.Try):
                self.outside(inner, prefix)

    def defaults(self, arguments: ast.arguments) -> None:
        """Defaults that are a number or a truth value."""
        plain = [*arguments.posonlyargs, *arguments.args]
        named = {
            "defaults": plain[len(plain) - len(arguments.defaults) :],
            "kw_defaults": arguments.kwonlyargs,
        }
        for place in places(arguments):
            if place.field in named and isinstance(place.get(), ast.Constant):
                self.default = named[place.field][place.index or 0].arg
                self.visit(place)
        self.default = None

    def body(self, block: ast.AST) -> None:
        """The statements of a block."""
        for place in places(block):
            node = place.get()
            if isinstance(node, ast.ExceptHandler | ast.match_case):
                self.body(node)
            elif isinstance(node, ast.stmt):
                outer, self.statement = self.statement, node
                self.leave_out(node, place)
                self.visit(place)
                self.statement = outer

    def leave_out(self, node: ast.stmt, place: Place) -> None:
        again = targets(node)
        anew = [t.id for t in again if isinstance(t, ast.Name)]
        silent = isinstance(node, ast.Expr) and not isinstance(node.value, ast.Constant | ast.Yield)
        ends = isinstance(node, ast.Return) and isinstance(place.parent, ast.If) and place.field == "body"
        leaves = isinstance(node, ast.Continue | ast.Break | ast.Raise | ast.AugAssign)
        assigns = isinstance(node, ast.Assign) and self.named.issuperset(anew)
        if silent or ends or leaves or assigns:
            self.add(place, ast.Pass())
        self.named |= set(anew)

    def visit(self, place: Place) -> None:
        node = place.get()
        if isinstance(node, ast.JoinedStr | ast.Raise | ast.Import | ast.ImportFrom | ast.Assert):
            return
        if isinstance(node, Function):
            self.body(node)
            return
        if visitor := self.visitors.get(type(node)):
            visitor(node, place)
        for inner in places(node):
            below = inner.get()
            if not isinstance(below, ast.stmt | ast.ExceptHandler | ast.match_case) and inner.field not in (
                "annotation",
                "op",
                "ops",
                "ctx",
            ):
                self.visit(inner)
        if isinstance(node, ast.stmt):
            self.body(node)

    def add(self, place: Place, *new: ast.AST) -> None:
        old = place.get()
        where = self.statement
        is_whole = old is where
        was = written(where)
        changes = []
        for node in new:
            place.put(node)
            changes.append(
                Change(was, "" if is_whole and isinstance(node, ast.Pass) else self.now(is_whole, node))
            )
            place.put(old)
        line = getattr(old, "lineno", where.lineno)
        self.sites.append(
            Site(
                self.function,
                self.first_line,
                self.default,
                line,
                lines_of(where),
                place,
                new,
                tuple(changes),
            )
        )

    def now(self, is_whole: bool, node: ast.AST) -> str:
        return written(cast(ast.stmt, node) if is_whole else self.statement)

    # --- operators ---

    def binary(self, node: ast.AST, place: Place) -> None:
        node = cast(ast.BinOp, node)
        other, alone = ARITHMETIC.get(type(node.op), (None, False))
        if other is None or (isinstance(node.left, ast.Constant) and isinstance(node.left.value, str)):
            return  # a text with % or +
        both: tuple[ast.AST, ...] = (node.left, node.right) if alone else ()
        self.add(place, ast.BinOp(node.left, other(), node.right), *both)

    def compare(self, node: ast.AST, place: Place) -> None:
        node = cast(ast.Compare, node)
        for i, op in enumerate(node.ops):
            new = [[*node.ops[:i], other(), *node.ops[i + 1 :]] for other in RELATIONS[type(op)]]
            self.add(place, *(ast.Compare(node.left, ops, node.comparators) for ops in new))

    def logical(self, node: ast.AST, place: Place) -> None:
        node = cast(ast.BoolOp, node)
        other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        rest = [[v for v in node.values if v is not left] for left in node.values]
        less = [values[0] if len(values) == 1 else ast.BoolOp(node.op, values) for values in rest]
        self.add(place, ast.BoolOp(other, node.values), *less)

    def unary(self, node: ast.AST, place: Place) -> None:
        node = cast(ast.UnaryOp, node)
        if not is_number(node.operand):
            self.add(place, node.operand)

    def constant(self, node: ast.AST, place: Place) -> None:
        value = cast(ast.Constant, node).value
        if isinstance(value, bool):
            self.add(place, ast.Constant(not value))
        elif is_number(node):
            new = [value + 1, value - 1] + [type(value)(0)] * (value not in (0, 1))
            self.add(place, *(ast.Constant(v) for v in new if v != value))

    def name(self, node: ast.AST, place: Place) -> None:
        node = cast(ast.Name, node)
        if node.id in self.constants and isinstance(node.ctx, ast.Load):
            one = ast.Constant(1)
            self.add(place, ast.BinOp(node, ast.Add(), one), ast.BinOp(node, ast.Sub(), one))
        elif node.id in COUNTERPARTS and isinstance(node.ctx, ast.Load) and node.id not in self.named:
            self.add(place, ast.Name(COUNTERPARTS[node.id], node.ctx))

    def attribute(self, node: ast.AST, place: Place) -> None:
        node = cast(ast.Attribute, node)
        if node.attr in COUNTERPARTS:
            self.add(place, ast.Attribute(node.value, COUNTERPARTS[node.attr], node.ctx))
        elif node.attr in ("T", "mT"):
            self.add(place, node.value)

    def call(self, node: ast.AST, place: Place) -> None:
        node = cast(ast.Call, node)
        called = node.func
        name = called.id if isinstance(called, ast.Name) else getattr(called, "attr", "")
        if name in LEFT_OUT and len(node.args) == 1:
            self.add(place, node.args[0])
        elif name in LEFT_OUT and isinstance(called, ast.Attribute) and not node.args:
            self.add(place, called.value)

    def conditional(self, node: ast.AST, place: Place) -> None:
        self.condition(Place(node, "test", None), both=not isinstance(node, ast.While))

    def comprehension(self, node: ast.AST, place: Place) -> None:
        for i in range(len(cast(ast.comprehension, node).ifs)):
            self.condition(Place(node, "ifs", i), both=True)

    def condition(self, place: Place, both: bool) -> None:
        if not isinstance(place.get(), ast.Constant):
            self.add(place, *(ast.Constant(v) for v in ((True, False) if both else (False,))))

    def augmented(self, node: ast.AST, place: Place) -> None:
        node = cast(ast.AugAssign, node)
        new: list[ast.AST] = [ast.Assign([node.target], node.value)]
        if other := ARITHMETIC.get(type(node.op)):
            new.insert(0, ast.AugAssign(node.target, other[0](), node.value))
        for i in new:
            ast.copy_location(i, node)
            ast.fix_missing_locations(i)
        self.add(place, *new)
