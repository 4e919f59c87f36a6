"""A real arithmetic coder and the spatial mask code in plain Python: sender and receiver."""

import math

import numpy as np


class Encoder:
    """Exact interval coder on integers (after Witten, Neal and Cleary 1987)."""

    BITS = 48

    def __init__(self):
        self.low, self.high, self.pending, self.bits = 0, (1 << self.BITS) - 1, 0, []

    def put(self, start, size, total):
        span = self.high - self.low + 1
        self.high = self.low + span * (start + size) // total - 1
        self.low = self.low + span * start // total
        half, quarter = 1 << (self.BITS - 1), 1 << (self.BITS - 2)
        while True:
            if self.high < half:
                self._emit(0)
            elif self.low >= half:
                self._emit(1)
                self.low -= half
                self.high -= half
            elif self.low >= quarter and self.high < half + quarter:
                self.pending += 1
                self.low -= quarter
                self.high -= quarter
            else:
                return
            self.low, self.high = 2 * self.low, 2 * self.high + 1

    def _emit(self, bit):
        self.bits += [bit] + [1 - bit] * self.pending
        self.pending = 0

    def finish(self):
        self.pending += 1
        self._emit(0 if self.low < 1 << (self.BITS - 2) else 1)
        return self.bits


class Decoder:
    def __init__(self, bits):
        self.bits, self.at = bits, 0
        self.low, self.high, self.value = 0, (1 << Encoder.BITS) - 1, 0
        for _ in range(Encoder.BITS):
            self.value = 2 * self.value + self._next()

    def _next(self):
        self.at += 1
        return self.bits[self.at - 1] if self.at <= len(self.bits) else 0

    def get(self, sizes):
        total = sum(sizes)
        span = self.high - self.low + 1
        target = ((self.value - self.low + 1) * total - 1) // span
        symbol, start = 0, 0
        while start + sizes[symbol] <= target:
            start += sizes[symbol]
            symbol += 1
        self.high = self.low + span * (start + sizes[symbol]) // total - 1
        self.low = self.low + span * start // total
        half, quarter = 1 << (Encoder.BITS - 1), 1 << (Encoder.BITS - 2)
        while True:
            if self.high < half:
                shift = 0
            elif self.low >= half:
                shift = half
            elif self.low >= quarter and self.high < half + quarter:
                shift = quarter
            else:
                return symbol
            self.low, self.high = 2 * (self.low - shift), 2 * (self.high - shift) + 1
            self.value = 2 * (self.value - shift) + self._next()


class Model:
    """Counts that sender and receiver keep alike; twice the count, so that all are integers."""

    def __init__(self, shape, planes):
        self.counts, self.planes = {}, planes
        self.upper = [0] * (shape[1] + 2)

    def row(self):
        self.left, self.corner = self.upper[1], self.upper[0]

    def look(self, x):
        above, right = self.upper[x + 1], self.upper[x + 2]
        near = (self.left, above, right, self.corner)
        equal = tuple(near[i] == near[j] for i in range(4) for j in range(i))
        self.context = (equal, self.left > 0)
        self.order = list(dict.fromkeys(near))
        counts = self.counts.setdefault(self.context, [1] * 5)
        others = [m for m in range(self.planes + 1) if m not in self.order]
        sizes = counts[: len(self.order)] + ([counts[4]] if others else [])
        return sizes, others

    def saw(self, x, label):
        symbol = self.order.index(label) if label in self.order else 4
        self.counts[self.context][symbol] += 2
        self.corner, self.upper[x + 1] = self.upper[x + 1], label
        self.left = label

    def skip(self, x):
        self.corner = self.upper[x + 1]


def seen(labels, there, planes):
    """What the model expects of every pixel, its place in that, the other labels and its own."""
    model = Model(labels.shape, planes)
    for y in range(labels.shape[0]):
        model.row()
        for x in range(labels.shape[1]):
            if not there[y, x]:
                model.skip(x)
                continue
            sizes, others = model.look(x)
            label = int(labels[y, x])
            symbol = model.order.index(label) if label in model.order else len(model.order)
            yield sizes, symbol, others, label
            model.saw(x, label)


def encode(labels, there, planes):
    coder = Encoder()
    for sizes, symbol, others, label in seen(labels, there, planes):
        coder.put(sum(sizes[:symbol]), sizes[symbol], sum(sizes))
        if label in others:
            coder.put(others.index(label), 1, len(others))
    return coder.finish()


def length(labels, there, planes):
    """Nats of a label image in the model, no coder's rounding."""
    total = 0.0
    for sizes, symbol, others, label in seen(labels, there, planes):
        total += math.log(sum(sizes) / sizes[symbol])
        total += math.log(len(others)) if label in others else 0.0
    return total


def decode(bits, there, planes):
    coder, model = Decoder(bits), Model(there.shape, planes)
    labels = np.zeros(there.shape, int)
    for y in range(there.shape[0]):
        model.row()
        for x in range(there.shape[1]):
            if not there[y, x]:
                model.skip(x)
                continue
            sizes, others = model.look(x)
            symbol = coder.get(sizes)
            if symbol == len(model.order):
                label = others[coder.get([1] * len(others))]
            else:
                label = model.order[symbol]
            labels[y, x] = label
            model.saw(x, label)
    return labels
