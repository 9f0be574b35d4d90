"""Scene files as text: read, judged by reading, edited; nothing here renders.

Others take: a scene with its parameters put in and the line of every element (`scene_file`), values
and lists of values from texts, materials among them (`values`), what a check hands back, indices
and surfaces of faces (`check_text`), what mesh files hold (`mesh_file`), the text of a scene with
changes made in place (`editor`), the scenes that ship with the package (`shipped`). `xml_tree` is
the room's own.
"""
