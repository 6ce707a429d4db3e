"""Programs of the graphics processor, in GLSL: how surfaces and tools look, and what they are.

Texture: triplanar mapping, three projections of a texture along the axes, weighted by the normal (Geiss, GPU Gems 3,
2007, chapter 1.5). Bumps: normals from derivatives of a height on the screen (Mikkelsen, JGT 2010). Highlights: GGX
(Walter et al., EGSR 2007). Llvmpipe computes both sides of a condition, so there is a program for each material, and
what varies slowly, the light that arrives, is computed at the vertices.
"""

from __future__ import annotations

VERTEX = """
#version 330
uniform mat4 to_view;
uniform mat4 to_clip;
uniform mat4 to_shadow;
uniform vec3 light_at;
uniform float reach;
uniform float exposure;
in vec3 position;
in vec3 normal;
in vec3 rest;
in vec3 rest_normal;
in float fraction;
out vec3 seen_at;
out vec3 seen_normal;
out vec3 stuck_at;
out vec3 stuck_normal;
out vec4 shadow_at;
out float strength;
out float within;
void main() {
    vec4 view = to_view * vec4(position, 1.0);
    seen_at = view.xyz;
    seen_normal = mat3(to_view) * normal;
    stuck_at = rest;
    stuck_normal = rest_normal;
    within = fraction;
    shadow_at = to_shadow * vec4(view.xyz + 0.0008 * normalize(seen_normal), 1.0);
    // A cone of light with soft edges. It decreases less than with the square of the distance, as the exposure of an
    // endoscope follows it.
    vec3 shone = seen_at - light_at;
    float away = length(shone);
    float cone = smoothstep(0.50, 0.98, shone.z / away);
    strength = exposure * mix(0.25, 1.0, cone) / (0.25 + 0.75 * pow(away / reach, 1.6));
    gl_Position = to_clip * view;
}
"""

LIT = """
#version 330
uniform vec3 albedo;
uniform vec3 inner;
uniform vec3 light_at;
uniform float period;
uniform float wetness;
uniform sampler2D tissue;
#ifdef SHADOWED
uniform sampler2DShadow shadow;
#endif
in vec3 seen_at;
in vec3 seen_normal;
in vec3 stuck_at;
in vec3 stuck_normal;
in vec4 shadow_at;
in float strength;
in float within;
layout(location = 0) out vec4 colour;

vec4 triplanar(vec3 at, vec3 normal) {
    vec3 weight = normal * normal;
    weight *= weight;
    weight /= weight.x + weight.y + weight.z;
    return weight.x * texture(tissue, at.yz) + weight.y * texture(tissue, at.zx) + weight.z * texture(tissue, at.xy);
}

vec3 bumped(vec3 normal, float height) {
    vec3 across = dFdx(seen_at), down = dFdy(seen_at);
    vec3 first = cross(down, normal), second = cross(normal, across);
    float area = dot(across, first);
    vec3 slope = sign(area) * (dFdx(height) * first + dFdy(height) * second);
    return normalize(abs(area) * normal - slope);
}

float ggx(float square, float sharp) {
    float part = square * (sharp - 1.0) + 1.0;
    return sharp / (part * part);
}

void main() {
    vec3 to_light = normalize(light_at - seen_at);
    vec3 to_eye = normalize(-seen_at);
#ifdef FLAT
    vec3 normal = cross(dFdx(seen_at), dFdy(seen_at));
#else
    vec3 normal = seen_normal;
#endif
    normal = normalize(dot(normal, seen_at) > 0.0 ? -normal : normal);
    vec3 base = albedo;
#ifdef TINTED
    base = mix(albedo, inner, smoothstep(0.3, 0.7, within));
#endif
#ifdef TISSUE
    vec4 look = triplanar(stuck_at / period, stuck_normal);
    base *= 0.30 + 0.95 * look.r + 0.45 * look.b;
    base = mix(base, base * vec3(0.45, 0.14, 0.22), 0.9 * look.g);
    base = mix(base, vec3(0.55, 0.27, 0.17), 0.30 * smoothstep(0.62, 0.95, look.r));
    normal = bumped(normal, 0.0008 * look.a);
#endif
    float lit = 1.0;
#ifdef SHADOWED
    lit = texture(shadow, 0.5 * shadow_at.xyz / shadow_at.w + 0.5);
#endif
    float towards = dot(normal, to_light);
    float facing = max(towards, 0.0) * lit;
    float cosine = dot(normal, normalize(to_light + to_eye));
    float square = cosine * cosine;
#ifdef METAL
    vec3 mirrored = reflect(-to_eye, normal);
    float room = 0.25 + 0.75 * smoothstep(-0.6, 0.7, -mirrored.y);
    vec3 light = base * (0.14 * facing + 0.24 * room * (0.3 + 0.7 * lit) + 0.55 * ggx(square, 0.012) * facing);
#else
    // Light that enters moist tissue comes out around, reddish, and a film on it shines.
    float around = max((towards + 0.3) / 1.3, 0.0) * (0.3 + 0.7 * lit);
    float rim = 1.0 - max(dot(normal, to_eye), 0.0);
    rim *= rim * rim;
    vec3 light = base * (vec3(0.40, 0.70, 0.80) * facing + vec3(0.60, 0.28, 0.18) * around + 0.03);
    light += wetness * ((0.055 * ggx(square, 0.0020) + 0.012 * ggx(square, 0.025)) * facing + 0.25 * base * rim);
#endif
    light *= strength;
    // Bright light saturates; the square root is the screen's encoding (sRGB) within 3 %.
    colour = vec4(sqrt(light * (1.0 + 0.12 * light) / (1.0 + light)), 1.0);
}
"""

WALL_VERTEX = """
#version 330
uniform vec4 lens;
uniform mat3 to_world;
in vec2 corner;
out vec3 towards;
void main() {
    towards = to_world * vec3((corner.x + lens.x) * lens.z, (corner.y + lens.y) * lens.w, 1.0);
    gl_Position = vec4(corner, 0.9999999, 1.0);
}
"""

# What lies behind everything: a dim wall, so far away that it moves only as the camera turns.
WALL = """
#version 330
uniform vec3 albedo;
in vec3 towards;
layout(location = 0) out vec4 colour;
void main() {
    vec3 ray = normalize(towards);
    float fold = ray.x * ray.y + 2.0 * ray.y * ray.z * ray.x - 1.5 * ray.z * ray.x;
    colour = vec4(sqrt(albedo * (0.7 + 0.9 * fold + 1.2 * fold * fold)), 1.0);
}
"""

# What is seen at each pixel: its distance along the axis, and its label.
DATA = """
#version 330
uniform int label;
in vec3 seen_at;
layout(location = 0) out float depth;
layout(location = 1) out uint number;
void main() {
    depth = seen_at.z;
    number = uint(label);
}
"""

SHADOW_VERTEX = """
#version 330
uniform mat4 to_clip;
in vec3 position;
void main() {
    gl_Position = to_clip * vec4(position, 1.0);
}
"""

SHADOW = """
#version 330
void main() {
}
"""


def lit(*words: str) -> str:
    """Return the program of a material: of TISSUE, TINTED, METAL, FLAT and SHADOWED those that apply."""
    first, _, rest = LIT.strip().partition("\n")
    return "\n".join([first, *(f"#define {word}" for word in words), rest])
