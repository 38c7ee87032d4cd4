"""One scene in every convention of its field: each file of exact rotations is CERTIFIED at zero.

World to camera R_i; 1DSfM and COLMAP have x right, y down, z forward, Bundler y up and z backward.
"""

import numpy as np
import pytest

from certpgo.io.exact.quaternion import to_write
from certpgo.linalg import rotations as so

N = 6
R = so.random(np.random.default_rng(0), N, 3)
T = np.random.default_rng(1).standard_normal((N, 3))
EDGES = [(k, (k + 1) % N) for k in range(N)] + [(0, 3), (4, 1)]
D = np.diag([1.0, -1.0, -1.0])


def row(numbers):
    return " ".join(f"{x:.12g}" for x in np.ravel(numbers))


def wxyz(matrix):
    return row(to_write(matrix[None])[0][[3, 0, 1, 2]])


def bundler():
    cameras = "".join(
        "".join(f"{row(line)}\n" for line in ([500, 0, 0], *(D @ R[k]), D @ T[k])) for k in range(N)
    )
    return f"# Bundle file v0.3\n{N} 0\n{cameras}"


def colmap():
    return "".join(f"{k} {wxyz(R[k])} {row(T[k])} 1 f{k}.png\n\n" for k in range(N))


FILES = {
    "rots.txt": lambda: "".join(f"{k} {row(R[k])}\n" for k in reversed(range(N))),
    "gt_rots.txt": lambda: "".join(f"{k} {row(R[k])}\n" for k in range(N)),
    "bundle.out": bundler,
    "images.txt": colmap,
    "global.txt": lambda: "".join(f"f{k}.png {wxyz(R[k])}\n" for k in reversed(range(N))),
}


@pytest.fixture
def scene(tmp_path):
    folder = tmp_path / "scene"
    folder.mkdir()
    lines = (f"{i} {j} {row(R[i] @ R[j].T)} 1 0 0\n" for i, j in EDGES)
    (folder / "EGs.txt").write_text("".join(lines))
    return folder


@pytest.mark.parametrize("name", FILES)
def test_exact_rotations_are_certified_at_zero(certpgo, scene, name):
    path = scene.parent / name
    path.write_text(FILES[name]())
    done = certpgo("certify", scene, path, "--json")
    assert done.code == 0, done.err
    assert done.json["cost"] < 1e-20
    assert done.json["objective"].startswith("F with weights 1: the file has no")
    # A camera that is turned is not.
    text = path.read_text().replace(wxyz(R[2]), wxyz(R[2] @ so.exp(np.array([0.1, 0, 0]))))
    if text != path.read_text():
        path.write_text(text)
        assert certpgo("certify", scene, path).code == 3


def test_all_of_them_in_one_csv(certpgo, scene):
    paths = [scene.parent / name for name in FILES]
    for path in paths:
        path.write_text(FILES[path.name]())
    done = certpgo("certify", scene, *paths, "--csv", scene.parent / "out.csv", "--json")
    assert done.code == 0
    assert [row["verdict"] for row in done.json] == ["CERTIFIED"] * len(FILES)


def test_glomaps_relative_poses_are_the_same_graph(certpgo, scene):
    relative = scene.parent / "relative.txt"
    lines = (f"f{i}.png f{j}.png {wxyz(R[j] @ R[i].T)} 1 0 0\n" for i, j in EDGES)
    relative.write_text("".join(lines))
    for name in ("images.txt", "global.txt", "rots.txt"):
        path = scene.parent / name
        path.write_text(FILES[name]())
        assert certpgo("certify", relative, path).code == 0
