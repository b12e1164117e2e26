"""A workflow of three levels, one of which a fourth branch revokes."""

from __future__ import annotations

THREE_LEVELS = b"""
id = "three"
version = "1"
[branches.top]
states = { a = "", b = "" }
operations.enter = { from = ["*"], to = "b" }
operations.again = { from = ["b"], to = "b", sets = { mid = "m0" } }
operations.leave = { from = ["b"], to = "a" }
operations.changed = { from = ["*"], to = "b", iio = true }
revocations = [{ by = ["watch"], from = ["b"], to = "a" }]
[branches.mid]
level = 2
states = { m0 = "", m1 = "" }
emits = { "*" = "changed" }
parent = { branch = "top", start = "b", compatible = { m0 = ["a", "b"], m1 = ["b"] } }
operations.step = { from = ["m0"], to = "m1" }
operations.changed = { from = ["m1"], to = "m1", iio = true }
operations.reinit = { from = ["*"], to = "m0", rio = true }
[branches.leaf]
level = 3
states = { l0 = "", l1 = "" }
emits = { "*" = "changed" }
parent = { branch = "mid", start = "m1", compatible = { l0 = ["m0", "m1"], l1 = ["m1"] } }
operations.step = { from = ["l0"], to = "l1" }
operations.reinit = { from = ["*"], to = "l0", rio = true }
[branches.watch]
states = { quiet = "", loud = "" }
operations.shout = { from = ["quiet"], to = "loud" }
operations.calm = { from = ["loud"], to = "quiet" }
"""
