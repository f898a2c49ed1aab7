"""The separation filter: the smallest change of the wanted acceleration that keeps off vehicles, obstacles and fence."""
