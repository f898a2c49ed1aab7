"""`make deb`: builds the Debian package. Maintainer scripts and control file are beside it."""
