"""Writes knot.ply, the object of the material scenes: a tube along a trefoil knot, with smooth normals."""

from pathlib import Path

import numpy as np

AROUND, ALONG, RADIUS = 28, 144, 0.56


def trefoil(t):
    """The knot's curve and its tangent, (n, 3) each."""
    curve = np.stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t)], axis=1)
    tangent = np.stack(
        [np.cos(t) + 4 * np.cos(2 * t), -np.sin(t) + 4 * np.sin(2 * t), -3 * np.cos(3 * t)], axis=1
    )
    return curve, tangent / np.linalg.norm(tangent, axis=1, keepdims=True)


def tube():
    """Vertices and normals (n, 3), and triangles (m, 3)."""
    t = np.arange(ALONG) / ALONG * 2 * np.pi
    curve, tangent = trefoil(t)
    # A frame that never degenerates: the knot is never parallel to its axis.
    across = np.cross(tangent, [0, 0, 1])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    up = np.cross(across, tangent)
    phi = np.arange(AROUND) / AROUND * 2 * np.pi
    normals = np.cos(phi)[None, :, None] * across[:, None] + np.sin(phi)[None, :, None] * up[:, None]
    vertices = curve[:, None] + RADIUS * normals
    i, j = np.meshgrid(np.arange(ALONG), np.arange(AROUND), indexing="ij")
    a, b = i * AROUND + j, (i + 1) % ALONG * AROUND + j
    c, d = (i + 1) % ALONG * AROUND + (j + 1) % AROUND, i * AROUND + (j + 1) % AROUND
    corners = ((a, b, c), (a, c, d))
    triangles = np.concatenate([np.stack(corner, axis=-1).reshape(-1, 3) for corner in corners])
    return vertices.reshape(-1, 3), normals.reshape(-1, 3), triangles


def main():
    vertices, normals, triangles = tube()
    # Everything within the unit sphere.
    scale = 1 / np.linalg.norm(vertices, axis=1).max()
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(vertices)}",
        *(f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")),
        f"element face {len(triangles)}",
        "property list uchar ushort vertex_indices",
        "end_header\n",
    ]
    faces = np.zeros(len(triangles), dtype=[("count", "u1"), ("corners", "<u2", 3)])
    faces["count"], faces["corners"] = 3, triangles
    data = np.hstack([scale * vertices, normals]).astype("<f4")
    path = Path(__file__).with_name("knot.ply")
    path.write_bytes("\n".join(header).encode() + data.tobytes() + faces.tobytes())


if __name__ == "__main__":
    main()
