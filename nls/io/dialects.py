"""The dialects of graph text files, and which one a file is in; the table of all formats is `nls.io.formats`.

    g2o       VERTEX_SE2 id x y theta                     EDGE_SE2 i j dx dy dtheta I11 I12 I13 I22 I23 I33
              VERTEX_SE3:QUAT id x y z qx qy qz qw        EDGE_SE3:QUAT i j x y z qx qy qz qw and 21 entries
              FIX id [id ...]                             and the rest of the table below
    TORO      VERTEX2 id x y theta           EDGE2 i j dx dy dtheta I11 I12 I22 I33 I13 I23         (mind the order)
              VERTEX3 id x y z roll pitch yaw    EDGE3 i j x y z roll pitch yaw and 21 entries of the information
    iSAM      ODOMETRY, EDGE2 or Constraint2 i j dx dy dtheta R11 R12 R13 R22 R23 R33
              LANDMARK i l x y R11 R12 R22       EDGE3 i j x y z roll pitch yaw and 21       POINT3 i l x y z and 6
    graph     VERTEX2, EDGE2 as TORO, the entries a *covariance* in the same order
    isam-covariance    ODOMETRY, EDGE2, LANDMARK as iSAM, the entries a *covariance*, upper triangle row by row

Poses of g2o are the variables ``x``, points ``l``, with the ids of the file. Vertices used only as the place of a
sensor on the vehicle are ``o``. The information is the upper triangle row by row; that of a pose of space is of (x, y,
z, qx, qy, qz). Its rotation part belongs to the *vector part of the quaternion*, half a rotation vector. For the
conventions ``g2o``, ``graphslam`` and ``gtsam`` it is taken verbatim, for ``log`` converted (rotation block / 4, mixed
blocks / 2: exact in binary).

R is the upper square root of the information, I = R'R, row by row. In space rotation is roll, pitch, yaw (see
`models.manifolds.euler`), and the entries are about those angles: nls.io.weights turns them. iSAM numbers its points
apart from its poses: pose 0 and point 0 are two variables, in both of its dialects. An EDGE2 line therefore
has four readings, and nothing in its numbers says which. Other tags may; where they do not, the file is refused with
the choices.

Sources: R. Kuemmerle et al., "g2o: a general framework for graph optimization", ICRA 2011, and the types registered in
its sources (slam2d, slam3d, sclam2d and their add-ons); G. Grisetti, C. Stachniss, W. Burgard, "Nonlinear constraint
network optimization for efficient map learning", T-ITS 2009, and TORO's description of its files; M. Kaess et al.,
"iSAM: incremental smoothing and mapping", T-RO 2008, and the loader of its example program; for the covariance readings
the noise formats of GTSAM's 2-D reader.
"""

import shlex

from factors.bearing import Bearing
from factors.between import Between
from factors.between_sensors import BetweenSensors
from factors.landmark import Landmark
from factors.position import Position
from factors.prior import Prior
from models import SE2, SE3, R
from models.advice import Advice
from models.algebra import Index
from models.errors import GraphFileError
from nls.io.records import Dialect, Element, Record
from nls.io.text import Text, printable

POSES = ("pose", "pose")
POSE_AND_POINT = ("pose", "point")
ANGLES = Element(SE3, "x y z roll pitch yaw", angles=True)
TORO_ORDER = "11 12 22 33 13 23"
POSE2, STEP2, POINT2 = Element(SE2, "x y theta"), Element(SE2, "dx dy dtheta"), Element(R(2), "x y")
ANGLE = Element(R(1), "beta")
POSE3, POINT3 = Element(SE3, "x y z qx qy qz qw"), Element(R(3), "x y z")

G2O_PLANE = (
    Record(b"VERTEX_SE2", SE2, ("pose",), POSE2),
    Record(b"VERTEX_XY", SE2, ("point",), POINT2),
    Record(b"PARAMS_SE2OFFSET", SE2, (), POSE2),
    Record(b"EDGE_SE2", SE2, ("pose", "pose"), STEP2, Between),
    Record(b"EDGE_SE2_XY", SE2, ("pose", "point"), POINT2, Landmark),
    Record(b"EDGE_BEARING_SE2_XY", SE2, ("pose", "point"), ANGLE, Bearing),
    Record(b"EDGE_PRIOR_SE2", SE2, ("either",), POSE2, Prior),
    Record(b"EDGE_PRIOR_SE2_XY", SE2, ("either",), POINT2, Position),
    Record(b"EDGE_PRIOR_XY", SE2, ("point",), POINT2, Prior),
    Record(b"EDGE_POINTXY", SE2, ("point", "point"), POINT2, Between),
    Record(b"EDGE_SE2_OFFSET", SE2, ("pose", "pose"), STEP2, BetweenSensors, parameters=2),
    Record(b"EDGE_SE2_POINTXY_OFFSET", SE2, ("pose", "point"), POINT2, Landmark, parameters=1),
    Record(b"EDGE_SE2_CALIB", SE2, ("pose", "pose", "mount"), STEP2, BetweenSensors),
    Record(b"EDGE_SE2_XY_CALIB", SE2, ("pose", "point", "mount"), POINT2, Landmark),
    Record(b"LANDMARK2", SE2, POSE_AND_POINT, POINT2, Landmark, foreign=True, apart=True),
    Record(b"EDGE_SE2_SWITCHABLE", SE2, POSES, STEP2, Between, 1, used=False, switched=True, foreign=True),
)
G2O_SPACE = (
    Record(b"VERTEX_SE3:QUAT", SE3, ("pose",), POSE3),
    Record(b"VERTEX_TRACKXYZ", SE3, ("point",), POINT3),
    Record(b"PARAMS_SE3OFFSET", SE3, (), POSE3),
    Record(b"EDGE_SE3:QUAT", SE3, ("pose", "pose"), POSE3, Between),
    Record(b"EDGE_SE3_TRACKXYZ", SE3, ("pose", "point"), POINT3, Landmark, parameters=1),
    Record(b"EDGE_SE3_PRIOR", SE3, ("either",), POSE3, Prior, parameters=1),
    Record(b"EDGE_SE3_XYZ_PRIOR", SE3, ("either",), POINT3, Position, parameters=1, used=False),
    Record(b"EDGE_POINTXYZ_PRIOR", SE3, ("either",), POINT3, Position, foreign=True),
    Record(b"EDGE_POINTXYZ_PRIOR", SE3, ("point",), POINT3, Prior),
    Record(b"EDGE_POINTXYZ", SE3, ("point", "point"), POINT3, Between),
    Record(b"EDGE_SE3_OFFSET", SE3, ("pose", "pose"), POSE3, BetweenSensors, parameters=2),
    Record(b"EDGE_SE3_CALIB", SE3, ("pose", "pose", "mount"), POSE3, BetweenSensors),
    Record(b"EDGE_SE3", SE3, POSES, POSE3, Between, foreign=True),
    Record(b"LANDMARK3", SE3, POSE_AND_POINT, POINT3, Landmark, foreign=True, apart=True),
    Record(b"EDGE_SE3_SWITCHABLE", SE3, POSES, POSE3, Between, 1, used=False, switched=True, foreign=True),
)
SWITCHES = (
    Record(b"VERTEX_SWITCH", SE2, (), Element(R(1), "value"), switched=True),
    Record(b"EDGE_SWITCH_PRIOR", SE2, (), Element(R(2), "value information"), switched=True),
)
G2O = Dialect(
    "g2o",
    G2O_PLANE + G2O_SPACE + SWITCHES,
    "information",
    "tags such as VERTEX_SE2 and EDGE_SE3:QUAT",
    fix=True,
    aliases=(
        (b"EDGE_SE2_PRIOR", b"EDGE_PRIOR_SE2"),
        (b"EDGE_PRIOR_SE3", b"EDGE_SE3_PRIOR"),
        (b"EDGE_SE3_PRIOR:QUAT", b"EDGE_SE3_PRIOR"),
        (b"EDGE_SE3:QUAT_SWITCHABLE", b"EDGE_SE3_SWITCHABLE"),
    ),
)

TORO_PLANE = (
    Record(b"VERTEX2", SE2, ("pose",), POSE2),
    Record(b"EDGE2", SE2, POSES, STEP2, Between, entries=TORO_ORDER),
)
TORO = Dialect(
    "toro",
    (*TORO_PLANE, Record(b"VERTEX3", SE3, ("pose",), ANGLES), Record(b"EDGE3", SE3, POSES, ANGLES, Between)),
    "information",
    "information, in the plane in the order I11 I12 I22 I33 I13 I23",
)
GRAPH = Dialect("graph", TORO_PLANE, "covariance", "covariance in the order of TORO")
ISAM_PLANE = (Record(b"EDGE2", SE2, POSES, STEP2, Between), Record(b"LANDMARK", SE2, POSE_AND_POINT, POINT2, Landmark))
ISAM = Dialect(
    "isam",
    (
        *ISAM_PLANE,
        Record(b"EDGE3", SE3, POSES, ANGLES, Between),
        Record(b"POINT3", SE3, POSE_AND_POINT, POINT3, Landmark),
    ),
    "square root",
    "upper square root of the information, row by row",
    aliases=((b"ODOMETRY", b"EDGE2"), (b"Constraint2", b"EDGE2")),
    ignored_tags=(b"SOLVE", b"VERTEX", b"POSE3D_TRUE", b"EDGE3_TRUE", b"EDGE2_TRUE", b"POSE3D_INIT", b"EDGE3_INIT"),
    apart=True,
)
ISAM_COVARIANCE = Dialect(
    "isam-covariance",
    ISAM_PLANE,
    "covariance",
    "covariance, row by row",
    aliases=((b"ODOMETRY", b"EDGE2"),),
    apart=True,
)
TAGGED = {dialect.name: dialect for dialect in (G2O, TORO, ISAM, ISAM_COVARIANCE, GRAPH)}
READINGS = {  # dialects by tag
    tag: {name for name, format in TAGGED.items() if tag in format.tags or tag in format.ignored_tags}
    for known in TAGGED.values()
    for tag in (*known.tags, *known.ignored_tags)
}
EXAMPLES = "EDGE_SE2 i j dx dy dtheta and 6 numbers (g2o), EDGE2 or EDGE3 (TORO, iSAM), ODOMETRY (iSAM)"

Tags = dict[bytes, Index]


def choose(text: Text, tags: Tags, comments: Index, dialect: str = "auto", part: bool = False) -> tuple[Dialect, str]:
    """The dialect of a file by its tags, and why; a part of a file whose dialect is named may have no known tag.

    Raises
    ------
    GraphFileError
        No tag of a graph, tags of several dialects, or tags that leave several readings: with the choices.
    """
    if dialect != "auto":
        format = TAGGED[dialect]
        if not part and not any(tag in format.tags for tag in tags):
            raise _no_graph(text, tags, comments, [format])
        return format, "as asked for"
    candidates = {tag: READINGS[tag] for tag in tags if tag in READINGS}
    if all(tag in ISAM.ignored_tags for tag in candidates):
        raise _no_graph(text, tags, comments, list(TAGGED.values()))
    left = set(TAGGED)
    for tag, names in candidates.items():
        if not left & names:
            raise text.error(
                f"{tag.decode()} is a tag of {_listed(names)}, the lines before are of {_listed(left)}; expected one "
                "dialect in a file, or name the dialect, and leave out the lines of others",
                int(tags[tag][0]),
            )
        left &= names
    vertices = [tag.decode() for tag in (b"VERTEX2", b"VERTEX3") if tag in tags]
    if vertices and left == {"toro", "graph"}:
        return TORO, f"{vertices[0]} lines are TORO's; name the dialect graph if its numbers are covariances"
    if len(left) == 1:
        (name,) = left
        deciding = min(candidates, key=lambda tag: len(candidates[tag])).decode()
        return TAGGED[name], f"by its tag {deciding}" if name != "g2o" else "by its tags"
    first = min(candidates, key=lambda tag: int(tags[tag][0]))
    choices = "; ".join(f"{name}: {format.says}" for name, format in TAGGED.items() if name in left)
    raise text.error(
        f"{first.decode()} lines have several readings, and no other tag of the file tells which ({choices})",
        int(tags[first][0]),
        [Advice("dialect"), Advice("info")],
    )


def _listed(names: set[str]) -> str:
    return " or ".join(name for name in TAGGED if name in names)


def _no_graph(text: Text, tags: Tags, comments: Index, formats: list[Dialect]) -> GraphFileError:
    """The error for a file without any line of a graph."""
    unknown, advice = [tag for tag in tags if tag != b"FIX"], []
    log = "LOG" if text.path == "<stdin>" else shlex.quote(text.path)
    table = [Advice("import", (log,)), Advice("template")]
    if unknown:
        line, word = int(tags[unknown[0]][0]), unknown[0]
        if b"," in text.line(line):
            problem, advice = "is no graph but a table, its numbers separated by commas", [Advice("mission"), *table]
        elif word.lstrip(b"+-.")[:1].isdigit():
            advice = table
            problem = f"is no graph but a table of numbers: a line begins with '{printable(word, 30)}' instead of a tag"
        elif b";" in text.line(line) or b"\t" in text.line(line).strip():
            sign = "semicolons" if b";" in text.line(line) else "tabs"
            problem, advice = f"is no graph but a table, its cells separated by {sign}", table
        else:
            problem = f"is no graph: '{printable(word, 30)}' is no tag of a graph"
    elif tags:
        line, problem = int(tags[b"FIX"][0]), "fixes vertices and has neither a vertex nor an edge"
    elif len(comments):
        line, problem = int(comments.min()), "has nothing but comments"
    else:
        line, problem = 0, "is empty"
    examples = EXAMPLES
    if len(formats) == 1:
        named = ", ".join(r.tag.decode() for r in formats[0].records if r.factor is not None and not r.foreign)
        examples = f"{named} (dialect {formats[0].name})"
    return text.error(f"{problem}; expected lines such as {examples}", line, advice)
