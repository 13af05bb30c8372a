"""A Mitsuba BSDF in Python that is broken in one way, for ``--import check_mutants``."""

import drjit as dr
import mitsuba as mi

INV_PI, INV_TWO_PI = 0.31830988618, 0.15915494309


class Mutant(mi.BSDF):
    """Lambert of albedo 0.5, sampled half by the cosine and half uniformly, with the bug ``bug``."""

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        self.bug = props.get("bug", "none")
        count = 2 if self.bug == "components" else 1
        self.m_components = [+mi.BSDFFlags.DiffuseReflection | +mi.BSDFFlags.FrontSide] * count
        self.m_flags = self.m_components[0]

    def sample(self, ctx, si, sample1, sample2, active=True):
        if self.bug == "misses half":
            sample2 = mi.Point2f(sample2.x, 0.5 * sample2.y)
        bs = mi.BSDFSample3f()
        bs.wo = dr.select(
            sample1 < 0.5,
            mi.warp.square_to_cosine_hemisphere(sample2),
            mi.warp.square_to_uniform_hemisphere(sample2),
        )
        if self.bug == "below":
            bs.wo.z = dr.select(sample2.y < 0.05, -bs.wo.z, bs.wo.z)
        bs.pdf = self.pdf(ctx, si, bs.wo, active)
        bs.eta = 1.0
        bs.sampled_type = mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
        bs.sampled_component = mi.UInt32(0)
        value = self.eval(ctx, si, bs.wo, active)
        weight = dr.select(bs.pdf > 0, value / dr.maximum(bs.pdf, 1e-20), 0)
        if self.bug == "weight":
            weight *= 1.05
        if self.bug == "cosine of weight":
            weight /= dr.maximum(bs.wo.z, 1e-6)
        return bs, weight

    def eval(self, ctx, si, wo, active=True):
        lit = (si.wi.z > 0) & ((wo.z > 0) | (self.bug == "below"))
        cosine = dr.abs({"swapped": si.wi.z, "cosine": mi.Float(1)}.get(self.bug, wo.z))
        value = mi.Color3f(dr.select(lit, 0.5 * INV_PI * cosine, 0))
        if self.bug == "nan":
            value = dr.select(si.wi.z == 1, dr.nan, value)
        return value

    def pdf(self, ctx, si, wo, active=True):
        lit = (si.wi.z > 0) & ((wo.z > 0) | (self.bug == "below"))
        term = 0 if self.bug == "pdf term" else 0.5 * INV_TWO_PI
        pdf = dr.select(lit, 0.5 * INV_PI * dr.abs(wo.z) + term, 0)
        return 1.02 * pdf if self.bug == "pdf" else pdf

    def eval_pdf(self, ctx, si, wo, active=True):
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    def to_string(self):
        return f"Mutant[bug={self.bug}]"


mi.register_bsdf("mutant", lambda props: Mutant(props))
