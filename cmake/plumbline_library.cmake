# plumbline_library(NAME DEPENDS ours... PRIVATE theirs...)
#
# One folder, one library: every .cc of the folder and of the folders in it. `ours` are folders further left in
# calib <- match <- fit <- track <- io <- apps; `theirs` stay private, so that a user of the library sees only std and Eigen.
# Shared libraries, because they carry what they need of theirs: a user links plumbline::io and nothing else.
function(plumbline_warnings target)
  target_compile_options(${target} PRIVATE -Wall -Wextra -Wconversion -Werror)
  if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
    target_compile_options(${target} PRIVATE -Wno-restrict)  # false alarms in std::string of g++ 12 (GCC bug 105651)
  endif()
  if(PLUMBLINE_SANITIZE)
    target_compile_options(${target} PRIVATE -fsanitize=${PLUMBLINE_SANITIZE} -fno-sanitize-recover=undefined
                                             -fno-omit-frame-pointer -g1)
    target_link_options(${target} PRIVATE -fsanitize=${PLUMBLINE_SANITIZE})
    if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
      target_compile_options(${target} PRIVATE -Wno-maybe-uninitialized)  # in std::regex, with ASan (GCC bug 105616)
    endif()
  endif()
endfunction()

function(plumbline_library name)
  cmake_parse_arguments(ARG "" "" "DEPENDS;PRIVATE" ${ARGN})
  file(GLOB_RECURSE sources CONFIGURE_DEPENDS ${CMAKE_CURRENT_SOURCE_DIR}/*.cc)
  list(FILTER sources EXCLUDE REGEX "/main\\.cc$")  # a program's main() is no part of its library
  if(NOT sources)  # a folder whose issue is still to come: a name to link, nothing in it
    add_library(plumbline_${name} INTERFACE)
    add_library(plumbline::${name} ALIAS plumbline_${name})
    set_target_properties(plumbline_${name} PROPERTIES EXPORT_NAME ${name})
    foreach(dependency ${ARG_DEPENDS})
      target_link_libraries(plumbline_${name} INTERFACE plumbline::${dependency})
    endforeach()
    return()
  endif()
  add_library(plumbline_${name} SHARED ${sources})
  add_library(plumbline::${name} ALIAS plumbline_${name})
  set_target_properties(plumbline_${name} PROPERTIES EXPORT_NAME ${name} VERSION ${PROJECT_VERSION}
                        SOVERSION ${PROJECT_VERSION_MAJOR}.${PROJECT_VERSION_MINOR})
  target_include_directories(plumbline_${name} PUBLIC
    $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}>
    $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>
    $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}/plumbline>)
  target_compile_features(plumbline_${name} PUBLIC cxx_std_20)
  target_link_libraries(plumbline_${name} PUBLIC Eigen3::Eigen)
  foreach(dependency ${ARG_DEPENDS})
    target_link_libraries(plumbline_${name} PUBLIC plumbline::${dependency})
  endforeach()
  foreach(library ${ARG_PRIVATE})
    target_link_libraries(plumbline_${name} PRIVATE ${library})
  endforeach()
  plumbline_warnings(plumbline_${name})
endfunction()
