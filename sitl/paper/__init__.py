"""The paper's claims (Hou and Zhang, Robotica 2021), each computed or flown again, each with a verdict."""
