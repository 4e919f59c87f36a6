"""E57 files of range and angles, written for the tests."""

import numpy as np
import pye57
from pye57 import libe57


def spherical_e57(path, scans):
    """Write scans of range and angles, which pye57 itself does not: floats, or steps of 1e-6."""

    def structure(parent, name, **values):
        node = libe57.StructureNode(image)
        parent.set(name, node)
        for key, value in values.items():
            node.set(key, libe57.FloatNode(image, float(value)))
        return node

    with pye57.E57(str(path), mode="w") as file:
        image = file.image_file
        for data, pose in scans:
            scan = libe57.StructureNode(image)
            scan.set("guid", libe57.StringNode(image, "{scan}"))
            if pose is not None:
                node = structure(scan, "pose")
                structure(node, "rotation", **dict(zip("wxyz", pose[0], strict=True)))
                structure(node, "translation", **dict(zip("xyz", pose[1], strict=True)))
            kinds, buffers = libe57.StructureNode(image), libe57.VectorSourceDestBuffer()
            for name, column in data.items():
                if column.dtype == np.uint8:  # nothing but zeros, which take no bits
                    kind = libe57.IntegerNode(image, 0, 0, 0)
                elif name == "sphericalAzimuth":
                    kind = libe57.ScaledIntegerNode(image, 0, -4_000_000, 4_000_000, 1e-6, 0.0)
                elif column.dtype == np.int8:
                    kind = libe57.IntegerNode(image, 0, 0, 2)
                else:
                    kind = libe57.FloatNode(image, 0.0)
                kinds.set(name, kind)
                size = len(column)
                buffers.append(libe57.SourceDestBuffer(image, name, column, size, True, True))
            vector = libe57.VectorNode(image, True)
            points = libe57.CompressedVectorNode(image, kinds, vector)
            scan.set("points", points)
            file.data3d.append(scan)
            writer = points.writer(buffers)
            writer.write(size)
            writer.close()
