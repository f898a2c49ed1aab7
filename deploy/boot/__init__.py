"""`make boot`: boots systemd in a container with the package installed, and checks the service."""
