"""Hostile values."""

import math

#: Float fields.
FLOATS = (
    math.nan, math.inf, -math.inf, 0.0, -0.0, 1.0, -1.0, 5e-324, -5e-324, 1e-310, 1e-9, 1e-3, 0.5, 1e3, -1e3,
    1e6, -1e6, 1e9, 1e17, 2.0**53 + 1, 1e200, -1e200, 1.7976931348623157e308, -1.7976931348623157e308,
)  # fmt: skip

#: Integer fields, wrapped into the field's range.
INTEGERS = (
    0, 1, -1, 2, 127, 128, 255, 999_999_999, 1_000_000_000, 4_000_000_000, 2**31 - 1, 2**31, 2**32 - 1,
    -(2**31), 2**63 - 1, -(2**63),
)  # fmt: skip

#: Lengths in serialized bytes, arrays and lists of names.
LENGTHS = (0, 1, 2, 3, 7, 100, 5000, 5001, 2**16, 2**31 - 1, 2**32 - 1)

#: String fields: names, frames and words.
STRINGS = (
    "", " ", "\x00", "a\x00b", "\n", "world", "odom", "map", "base", "nan", "None", "..", "/", "~", "%s%n", "{}",
    "left\nfoot", "é", "関節", "\u202egnitset", "\U0001f916", "e\u0301", "\ufeff", "'", '"', "\\", "a" * 41, "a" * 4097,
    "activate", " estop ", "estopp", "ESTOP",
)  # fmt: skip

#: Words on topics of words, including valid ones.
WORDS = ("activate", "deactivate", "damp", "reset", "estop", "inactive", "active", "damping", "fault", "stopped")

#: Values in a YAML text.
SCALARS = (
    "", "~", ".nan", ".inf", "-.inf", "nan", "inf", "1e400", "-1e400", "1e200", "-1", "0", "1e-320", "0x" + "f" * 3700,
    "0x1F", "0o777", "9" * 400, "9" * 4000, "-" + "9" * 31, "1_000", "190:20:30", "1.5.2", "1,5", "true", "yes", "abc",
    "''", '"\\0"', '"\\U0001F916"', "[]", "[[]]", "{}", "[1, 2, 3]", "[.nan, 0, 0]", "{a: 1}", "2001-99-99",
    "2001-12-14t21:59:43.10-05:00", "!!python/object/apply:os.system [true]", "!!binary aGk=", "!!set {a, b}",
    "!!float abc", "!!int 1e3", "!!timestamp x", "!!null x", "!unknown 1", "*a", "&a [*a]", "&a 1", "<<", "? a", "- 1",
    "| x", "> x", "@", "`", "%", "'", '"', "[" * 2000, "{a: " * 500, "é", "\x07", "\u2028", "x" * 5000,
)  # fmt: skip

#: Complete YAML texts: bombs, nesting, duplicates, several documents.
TEXTS = (
    "", "\x00", "---", "...", "--- 1\n--- 2", "%YAML 9.9\n---\na", "\t", "a: b: c", "[" * 4000, "{" * 4000, "- " * 2000,
    "a: &a [x, x]\nb: &b [*a, *a]\nc: &c [*b, *b]\nd: [*c, *c]",
    "a: &a {<<: *a}", "{a: &x {b: *x}}", "? [a, b]\n: 1", "? {a: 1}\n: 1", "{1: 2, 1.0: 3}", "{true: 1, null: 2}",
    "{tasks: {com: {weight: 1, weight: 2}}}", "{tasks: {<<: {com: {weight: 1}}}}",
    "{tasks: {com: {<<: {weight: .nan}}}}",
    "{tasks: {com: {weight: 0x" + "f" * 3700 + "}}}", "{safety: {activation_ramp: 0x" + "f" * 3700 + "}}",
    "{control: {weight_ramp: " + "9" * 4000 + "}}", "{tasks: {com: {setpoint: [0, 0, " + "9" * 400 + "]}}}",
    "{safety: {damping: 1e5, state_timeout: 1.0}}", "{limits: {torque_rate: 1e5}}", "{limits: {acceleration: 1e-300}}",
    "{limits: {position_margin: 1e300}}", "{limits: {velocity_scale: 5e-324}}", "{control: {weight_ramp: 5e-324}}",
    "{tasks: {com: {stiffness: 1e5, damping: 0}}}", "{tasks: {com: {stiffness: [1, 2]}}}", "{tasks: {com: null}}",
    "{tasks: {com: {weight: 1e6, enabled: true, setpoint: [0, 0, 1e200]}}}", "{contacts: {}}", "{tasks: 1}", "[tasks]",
    "{tasks: {com: {type: posture}}}", "{robot: {joints: []}}", "{contacts: {nose: {enabled: true}}}", "{? tasks}",
)  # fmt: skip

#: Values of XML attributes.
ATTRIBUTES = (
    "", " ", "nan", "inf", "-inf", "1e400", "-1", "0", "1e-320", "1e200", "abc", "1,5", "0x10", "1 2", "1 2 3 4",
    "nan nan nan", "0 0 0", "1e308 1e308 1e308", "é", "\u202e", "a" * 5000, "world", "base", "universe", "root_joint",
    "fixed", "floating", "planar", "continuous", "revolute", "prismatic", "spherical", "&lt;", "../..", "%s", "٣",
)  # fmt: skip

#: Valid updates to be mutated.
UPDATES = (
    "{tasks: {com: {weight: 5.0, enabled: true, setpoint: [0.0, 0.0, 0.3]}}}",
    "{tasks: {com: {stiffness: 90.0, damping: [19.0, 19.0, 19.0], setpoint_duration: 2.0}, posture: {weight: 0.01}}}",
    "{contacts: {front_left_foot: {enabled: false, ramp: 0.2}}, control: {weight_ramp: 0.4}}",
    "{limits: {acceleration: 200.0, position_margin: 0.02}, tasks: {base: {weight: 3}}}",
)
