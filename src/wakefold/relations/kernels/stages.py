"""One step of the beliefs about how far along its chain each pair is: see ``wakefold.relations.activities``."""

from wakefold.base.compile import kernel


@kernel
def advance(stages, before, on, off, whole, fraction, out):
    """Beliefs over stages after a step, into ``out``.

    Args:
        stages: (P, S): apart before; parts of the least time one after the other, and long enough; apart after.
        before: (P,) probability of the relation of before, given what was seen now.
        on, off: (P,) probabilities that it has switched since.
        whole, fraction: parts of the least time that have passed; ``whole`` at most their number.
    """
    done = stages.shape[1] - 2  # the stage "long enough"; parts are 1 to done - 1
    for i in range(len(stages)):
        held = 0.0
        for k in range(1, done + 1):
            held += stages[i, k]
        related = before[i] / held if held > 0.0 else 0.0
        gone = stages[i, 0] + stages[i, done + 1]
        apart = (1.0 - before[i]) / gone if gone > 0.0 else 0.0
        fresh = 0.0 if held > 0.0 else before[i]  # what was seen now says it, and nothing before did
        for k in range(done + 2):
            out[i, k] = 0.0
        for k in range(1, done + 1):
            part = stages[i, k] * related + (fresh if k == 1 else 0.0)
            out[i, min(k + whole, done)] += (1.0 - fraction) * part
            if fraction > 0.0:
                out[i, min(k + whole + 1, done)] += fraction * part
        ended = 0.0
        for k in range(1, done):
            ended += out[i, k] * off[i]
            out[i, k] -= out[i, k] * off[i]
        over = out[i, done] * off[i]
        was, after = stages[i, 0] * apart if gone > 0.0 else 1.0 - before[i], stages[i, done + 1] * apart
        out[i, done] += after * on[i] - over
        out[i, 0] = was - was * on[i] + ended
        out[i, 1] += was * on[i]
        out[i, done + 1] = after - after * on[i] + over
        total = 0.0
        for k in range(done + 2):
            out[i, k] = max(out[i, k], 0.0)
            total += out[i, k]
        for k in range(done + 2):
            out[i, k] /= total
