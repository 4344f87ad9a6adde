"""Writes the protos of the features in a folder from their definitions, by the standard's own stylesheet."""
import pathlib, sys
from sila2.framework.utils import feature_definition_to_proto_string, parse_feature_definition
for fdl in sorted(pathlib.Path(sys.argv[1]).glob("*.sila.xml")):
    (fdl.parent / fdl.name.replace(".sila.xml", ".proto")).write_text(feature_definition_to_proto_string(parse_feature_definition(str(fdl))))
