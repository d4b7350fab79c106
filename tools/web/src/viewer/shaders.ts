/** Splats of one instance: drivers pay for each instance, so that one for each splat is many times slower. */
export const SPLATS_PER_INSTANCE = 128;
/** Texels of a row of every texture that holds splats. */
export const TEXTURE_WIDTH = 2048;

/** Steps of stored compensation (SPEC 8.5), 16 bits each: log scale and logit of the opacity. */
export const SCALE_STEPS = 2048;
export const OPACITY_STEPS = 1024;

/** Reads splats (`shader_rows.ts`), projects each (SPEC 8.7) and covers it with a triangle. */
export const VERTEX_SHADER = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;

uniform usampler2D splats;
uniform usampler2D shapes;
uniform usampler2D sh1;
uniform usampler2D sh2;
uniform usampler2D sh3;
uniform usampler2D order;
uniform usampler2D shifts;
uniform usampler2D levels;
uniform bool compensated;
uniform bool levelled;
uniform float between;       // share of the finer level
uniform int count;
uniform int degree;
uniform mat3 rotation;       // world to camera: x right, y down, z forward
uniform vec3 cameraPosition; // in the space of the means, rounded
uniform vec3 translation;    // of that position in the space of the camera
uniform vec2 focal;          // px
uniform vec2 principal;      // px from the middle
uniform vec2 viewport;       // px
uniform vec2 middle;         // of the picture, in halves of it
uniform vec2 depth;          // the depth of a z is x + y / z, and 0 in pictures of splats alone
uniform float kernel;        // px^2, added to projected covariances
uniform bool antialiased;
uniform vec4 trainingPixel;  // its area is w times the squared distance from xyz, plus trainingRest, not known where w is 0
uniform float trainingRest;
uniform vec2 rgbRange;
uniform float shRange;

out vec4 colour;
out vec2 offset;

const float NEAR = 0.2;
const float ALPHA_MIN = 1.0 / 255.0;

ivec2 texel(int index) { return ivec2(index & 2047, index >> 11); }

vec4 rotationOf(uint u, uint v, uint angle) {
  vec2 f = vec2(float(u), float(v)) / 127.5 - 1.0;
  vec3 axis = vec3(f, 1.0 - abs(f.x) - abs(f.y));
  float fold = max(-axis.z, 0.0);
  axis.x += axis.x >= 0.0 ? -fold : fold;
  axis.y += axis.y >= 0.0 ? -fold : fold;
  float half_angle = float(angle) * (3.14159265 / 510.0);
  return vec4(normalize(axis) * sin(half_angle), cos(half_angle));
}

mat3 matrixOf(vec4 q) {
  vec3 d = q.xyz * q.xyz;
  float xy = q.x * q.y, xz = q.x * q.z, yz = q.y * q.z, wx = q.w * q.x, wy = q.w * q.y, wz = q.w * q.z;
  return mat3(1.0 - 2.0 * (d.y + d.z), 2.0 * (xy + wz), 2.0 * (xz - wy),
              2.0 * (xy - wz), 1.0 - 2.0 * (d.x + d.z), 2.0 * (yz + wx),
              2.0 * (xz + wy), 2.0 * (yz - wx), 1.0 - 2.0 * (d.x + d.y));
}

float code(uvec4 words, int at, int bits) {
  int word = at >> 5, shift = at & 31;
  uint value = words[word] >> shift;
  if (shift + bits > 32) value |= words[word + 1] << (32 - shift);
  return float(int(value << (32 - bits)) >> (32 - bits));
}

vec3 coefficient(uvec4 words, int k, int bits) {
  return vec3(code(words, 3 * k * bits, bits), code(words, (3 * k + 1) * bits, bits), code(words, (3 * k + 2) * bits, bits));
}

vec3 higherBands(int index, vec3 d) {
  if (degree < 1) return vec3(0.0);
  float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
  uvec4 w = uvec4(texelFetch(sh1, texel(index), 0).xy, 0u, 0u);
  vec3 sum = 0.4886025 * (-y * coefficient(w, 0, 7) + z * coefficient(w, 1, 7) - x * coefficient(w, 2, 7)) / 63.0;
  if (degree > 1) {
    w = texelFetch(sh2, texel(index), 0);
    sum += (1.0925484 * x * y * coefficient(w, 0, 8) - 1.0925484 * y * z * coefficient(w, 1, 8) +
            0.3153916 * (2.0 * zz - xx - yy) * coefficient(w, 2, 8) - 1.0925484 * x * z * coefficient(w, 3, 8) +
            0.5462742 * (xx - yy) * coefficient(w, 4, 8)) / 127.0;
  }
  if (degree > 2) {
    w = texelFetch(sh3, texel(index), 0);
    sum += (-0.5900436 * y * (3.0 * xx - yy) * coefficient(w, 0, 6) + 2.8906114 * x * y * z * coefficient(w, 1, 6) -
            0.4570458 * y * (4.0 * zz - xx - yy) * coefficient(w, 2, 6) +
            0.3731763 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * coefficient(w, 3, 6) -
            0.4570458 * x * (4.0 * zz - xx - yy) * coefficient(w, 4, 6) +
            1.4453057 * z * (xx - yy) * coefficient(w, 5, 6) -
            0.5900436 * x * (xx - 3.0 * yy) * coefficient(w, 6, 6)) / 31.0;
  }
  return sum * shRange;
}

void main() {
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0); // outside, where nothing is to be drawn
  int slot = gl_InstanceID * ${SPLATS_PER_INSTANCE} + gl_VertexID / 3;
  if (slot >= count) return;
  int index = int(texelFetch(order, texel(slot), 0).x);
  uvec4 w = texelFetch(splats, texel(index), 0);
  float opacity = float(w.w >> 24) / 255.0;
  if (levelled) {
    uint pair = texelFetch(levels, texel(index), 0).x;
    opacity = mix(float(pair & 255u), float(pair >> 8 & 255u), between) / 255.0;
  }
  vec2 shift = vec2(0.0);
  if (compensated) {
    int word = int(texelFetch(shifts, texel(index), 0).x);
    shift = vec2(float(word << 16 >> 16) / ${SCALE_STEPS}.0, float(word >> 16) / ${OPACITY_STEPS}.0);
    float odds = opacity * exp(shift.y);
    opacity = odds / (odds + 1.0 - opacity);
  }
  vec3 mean = uintBitsToFloat(w.xyz);
  // Near the camera the difference is exact, where a product with the mean would be rounded.
  vec3 away = mean - cameraPosition;
  vec3 p = rotation * away + translation;
  if (p.z < NEAR || opacity < ALPHA_MIN) return;

  uvec2 s = texelFetch(shapes, texel(index), 0).xy;
  vec3 scale = exp(vec3(uvec3(s.y, s.y >> 8, s.y >> 16) & 255u) * (21.0 / 254.0) - (12.0 + 21.0 / 254.0) + shift.x);
  mat3 axes = rotation * matrixOf(rotationOf((s.x >> 16) & 255u, s.x >> 24, s.y >> 24));
  axes[0] *= scale.x; axes[1] *= scale.y; axes[2] *= scale.z;
  vec2 half_size = 0.5 * viewport / abs(focal), aside = 2.0 * principal / viewport + vec2(middle.x, -middle.y);
  vec2 t = clamp(p.xy / p.z, (-1.3 - aside) * half_size, (1.3 - aside) * half_size);
  vec3 jx = vec3(focal.x / p.z, 0.0, -focal.x * t.x / p.z);
  vec3 jy = vec3(0.0, focal.y / p.z, -focal.y * t.y / p.z);
  vec3 u = jx * axes, v = jy * axes;
  float a = dot(u, u), b = dot(u, v), c = dot(v, v);
  // A sum of squares, where a·c − b·b of thin splats cancels.
  vec3 across = cross(u, v);
  float determinant = dot(across, across);
  // The trained thickness, then the filter that keeps the opacity in sum (SPEC 8.7), px^2.
  float thickness = antialiased ? 0.0 : kernel, blur = antialiased ? kernel : 0.0;
  if (trainingPixel.w > 0.0 && !antialiased) {
    vec3 aside = mean - trainingPixel.xyz;
    float share = (trainingPixel.w * dot(aside, aside) + trainingRest) * abs(focal.x * focal.y) / dot(away, away);
    thickness = kernel * share;
    blur = max(0.0, 1.0 - share) / 12.0;
  }
  determinant += thickness * (a + c) + thickness * thickness;
  a += thickness; c += thickness;
  float before = determinant;
  determinant += blur * (a + c) + blur * blur;
  a += blur; c += blur;
  if (!(determinant > 0.0)) return;
  opacity *= sqrt(before / determinant);
  if (opacity < ALPHA_MIN) return;

  // The ellipse where alpha falls to 1/255, by the eigenvectors of the covariance.
  float tilt = 0.5 * (a - c);
  float spread = length(vec2(tilt, b));
  float longer = 0.5 * (a + c) + spread;
  float reach = sqrt(2.0 * log(opacity / ALPHA_MIN));
  vec2 direction = spread > 0.0 ? normalize(tilt > 0.0 ? vec2(tilt + spread, b) : vec2(b, spread - tilt)) : vec2(1.0, 0.0);
  int number = gl_VertexID % 3;
  // A triangle around the circle that the ellipse is of: one costs less than the two of a square.
  vec2 corner = (number == 0 ? vec2(0.0, 2.0) : vec2(number == 1 ? -1.7320508 : 1.7320508, -1.0)) * reach;
  vec2 px = corner.x * sqrt(longer) * direction + corner.y * sqrt(determinant / longer) * vec2(direction.y, -direction.x);
  vec2 centre = focal * p.xy / p.z + principal;
  offset = corner;
  vec3 dc = vec3(uvec3(w.w, w.w >> 8, w.w >> 16) & 255u) / 255.0 * (rgbRange.y - rgbRange.x) + rgbRange.x;
  colour = vec4(max(dc + higherBands(index, normalize(away)), 0.0), opacity);
  gl_Position = vec4((centre + px) * vec2(2.0, -2.0) / viewport + middle, depth.x + depth.y / p.z, 1.0);
}
`;

export const FRAGMENT_SHADER = `#version 300 es
precision highp float;
in vec4 colour;
in vec2 offset;
out vec4 pixel;

void main() {
  float alpha = min(0.99, colour.a * exp(-0.5 * dot(offset, offset)));
  if (alpha < 1.0 / 255.0) discard;
  pixel = vec4(colour.rgb * alpha, alpha);
}
`;

/** Spans the picture with one triangle. */
export const WHOLE_PICTURE_SHADER = `#version 300 es
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}
`;

/**
 * Blends the picture of the splats over the background; while a scene arrives, fills holes with the surrounding colour.
 *
 * Coarser levels of the picture are its averages, so that a level in which a pixel is covered tells the colour of the
 * nearest splats. Where even the coarsest level is hardly covered there is no hole but the end of the scene.
 */
export const COMPOSITE_SHADER = `#version 300 es
precision highp float;
uniform highp sampler2D picture;  // premultiplied by alpha
uniform vec4 background;          // display-encoded, not premultiplied
uniform float fill;
uniform ivec2 corner;             // px, of the picture in the render target
uniform int divide;               // px; left of it the second scene is drawn
uniform bvec2 linear;             // of the scene right of the divide, and left
out vec4 pixel;

vec3 encoded(vec3 c) { return mix(12.92 * c, 1.055 * pow(max(c, 0.0), vec3(1.0 / 2.4)) - 0.055, greaterThan(c, vec3(0.0031308))); }
vec3 decoded(vec3 c) { return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), greaterThan(c, vec3(0.04045))); }

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy) - corner;
  vec4 c = texelFetch(picture, at, 0);
  if (fill > 0.0) {
    vec2 uv = (vec2(at) + 0.5) / vec2(textureSize(picture, 0));
    vec4 around = vec4(0.0);
    for (int level = 6; level > 0; level--) {
      vec4 coarse = textureLod(picture, uv, float(level));
      around = coarse + around * (1.0 - coarse.a);
    }
    float inside = smoothstep(0.35, 0.85, textureLod(picture, uv, 5.0).a);
    vec3 colour = around.rgb / max(around.a, 1e-3);
    c += (1.0 - c.a) * fill * inside * vec4(colour, 1.0);
  }
  bool isLinear = at.x < divide ? linear.y : linear.x;
  vec3 behind = isLinear ? decoded(background.rgb) : background.rgb;
  vec3 sum = c.rgb + (1.0 - c.a) * background.a * behind;
  float alpha = c.a + (1.0 - c.a) * background.a;
  pixel = vec4(isLinear ? encoded(sum) : sum, alpha);
}
`;
