"""glTF 2.0 (.glb, .gltf): named morph targets, textures, vertex colours, materials, animation.

glTF is in metres, the project in millimetres: `write_gltf` divides by 1000 and `read_gltf` multiplies, so that a scene
comes back in the unit it was given in. Texture coordinates have v upwards on this side, downwards in the file.
"""

from facewright.io.gltf_reader import read_gltf
from facewright.io.gltf_scene import GltfAnimation, GltfMaterial, GltfMesh, GltfScene
from facewright.io.gltf_writer import write_gltf

__all__ = ["GltfAnimation", "GltfMaterial", "GltfMesh", "GltfScene", "read_gltf", "write_gltf"]
