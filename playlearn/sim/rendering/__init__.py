"""From a simulator state to an image, quickly: simplified meshes, culling, OpenGL without a display."""
