"""Where face geometry comes from: the built-in face, ICT-FaceKit, simulated people."""
