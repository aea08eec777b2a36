"""Drilling twin: one arm holds a board, the other drills into it, and both yield.

Quasi-static, in the base frame that both arms share. The axial force follows the feed, the hole guides the drill
sideways, the joints of both arms yield under what the drill and the board do to each other, and a compensation that
reads both wrist sensors may move the joints back. Model, symbols and assumed values: docs/theory.md, "Drilling twin".
"""
