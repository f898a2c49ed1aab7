"""The figures of the page, each as one self-contained picture."""
