"""Triangle meshes: files, measures, distances, samples, analytic shapes, remeshing."""
