# Used by `pip install` (see pyproject.toml) and by colcon inside a virtual environment of ROS wheels; a build on a full ROS installation never includes it.
cmake_minimum_required(VERSION 3.19)
find_package(Python3 REQUIRED COMPONENTS Interpreter)

# The wheels' prefix: pip's build isolation overlay, or the virtual environment itself.
execute_process(
  COMMAND "${Python3_EXECUTABLE}" -c
    "import pathlib, rosidl_cli; print(next(p for p in pathlib.Path(rosidl_cli.__file__).resolve().parents if (p / 'share/ament_index').is_dir()))"
  OUTPUT_VARIABLE ros_wheels_prefix
  OUTPUT_STRIP_TRAILING_WHITESPACE
  COMMAND_ERROR_IS_FATAL ANY
)
message(STATUS "ROS wheels found under ${ros_wheels_prefix}")
list(PREPEND CMAKE_PREFIX_PATH "${ros_wheels_prefix}")
set(ENV{AMENT_PREFIX_PATH} "${ros_wheels_prefix}")
if(DEFINED SKBUILD)
  set(PYTHON_INSTALL_DIR "../platlib" CACHE STRING "" FORCE)
endif()

# Imported targets of the wheels carry include directories of the machine they were built on, which CMake rejects.
function(drop_missing_include_directories)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(directories ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(NOT directories)
      continue()
    endif()
    set(existing "")
    foreach(directory IN LISTS directories)
      if(directory MATCHES "^\\$<" OR EXISTS "${directory}")
        list(APPEND existing "${directory}")
      endif()
    endforeach()
    set_property(TARGET ${target} PROPERTY INTERFACE_INCLUDE_DIRECTORIES "${existing}")
  endforeach()
endfunction()
cmake_language(DEFER CALL drop_missing_include_directories)
