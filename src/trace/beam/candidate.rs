//! A Gaussian or triangle as one tile sees it: what its quads need to order and to evaluate it.

/// What a quad needs to evaluate a Gaussian or a triangle at its texels. (x, y) are texels from the tile's corner.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    /// `u = u[0] + u[1] x + u[2] y`, likewise the others; all three share one scale, which cancels.
    pub u: [f32; 3],
    pub s: [f32; 2],
    pub h: [f32; 3],
    /// `|p|^2 log2(e) / 2`: the response is `2^(log2_opacity - falloff (u^2 + s^2) / (v.v))`.
    pub falloff: f32,
    pub log2_opacity: f32,
    /// `|p|` in the scale of h: the depth of the strongest response is `depth h / (v.v)`.
    pub depth: f32,
    /// Texels respond where `sqrt(u^2 + s^2)` is at most some factor times h. This affine form, at the middle of a quad of
    /// texels, is at least that square root wherever any texel of the quad responds.
    pub cone: [f32; 3],
    /// `depth (1 - r^2 / |p|^2)`, or 0: the least depth of a response is at least this over the largest h, and at least
    /// `nearest`. For a thin disc that is its plane, however oblique.
    pub depth_low: f32,
    pub nearest: f32,
    /// A lower bound on the sort keys of its contributions, and for `cameraDistance` the key itself.
    pub key_low: f32,
    pub colour: [f32; 3],
    /// Whether `colour` is linear radiance, and not in the splats' encoding.
    pub linear: bool,
    /// Into the scene's Gaussians, or its triangles when [`Candidate::TRIANGLE`] is set.
    pub index: u32,
    /// First and last column and row of texels that it may touch.
    pub columns: [i16; 2],
    pub rows: [i16; 2],
    /// Blocks it may touch.
    pub blocks: u64,
}

impl Candidate {
    /// Marks `index` as a triangle's; scenes of 2^31 primitives do not fit in memory.
    pub const TRIANGLE: u32 = 1 << 31;

    pub fn is_gaussian(&self) -> bool {
        self.index & Self::TRIANGLE == 0
    }

    pub fn triangle(&self) -> u32 {
        self.index & !Self::TRIANGLE
    }

    /// The depth of a Gaussian's strongest response along the ray through a texel position.
    #[inline(always)]
    pub fn depth_at(&self, x: f32, y: f32) -> f32 {
        let u = self.u[0] + self.u[1] * x + self.u[2] * y;
        let h = self.h[0] + self.h[1] * x + self.h[2] * y;
        let s = self.s[0] + self.s[1] * y;
        self.depth * h / (u * u + s * s + h * h)
    }

    /// A lower bound on the depths of its contributions in a square of texels, given by its first texel and its edge.
    #[inline(always)]
    pub fn depth_low_in(&self, x: f32, y: f32, edge: f32) -> f32 {
        // Where it responds, u^2 + s^2 <= r^2 v.v / |p|^2, so v.v <= h^2 / (1 - r^2 / |p|^2), and the depth
        // |p| h / v.v is at least |p| (1 - r^2 / |p|^2) / h.
        let [h0, hx, hy] = self.h;
        let steepest = h0 + hx * x + hy * y + edge * (hx.max(0.0) + hy.max(0.0));
        let plane = if steepest > 0.0 { self.depth_low / steepest } else { 0.0 };
        if plane > self.nearest { plane } else { self.nearest }
    }
}
