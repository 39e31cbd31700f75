# Install, and a package that find_package(plumbline) finds. Each folder is an imported target plumbline::calib and so on.
set(PLUMBLINE_FOLDERS calib match fit track io)
set(PLUMBLINE_TARGETS ${PLUMBLINE_FOLDERS})
list(TRANSFORM PLUMBLINE_TARGETS PREPEND plumbline_)
install(TARGETS ${PLUMBLINE_TARGETS} EXPORT plumbline)
install(TARGETS plumbline_apps)
foreach(folder ${PLUMBLINE_FOLDERS})
  install(DIRECTORY ${folder} DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/plumbline
          FILES_MATCHING PATTERN "*.h" PATTERN internal EXCLUDE)
endforeach()
install(EXPORT plumbline NAMESPACE plumbline:: DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/plumbline FILE plumbline-targets.cmake)
configure_package_config_file(cmake/plumbline-config.cmake.in ${PROJECT_BINARY_DIR}/plumbline-config.cmake
  INSTALL_DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/plumbline)
write_basic_package_version_file(${PROJECT_BINARY_DIR}/plumbline-config-version.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/plumbline-config.cmake ${PROJECT_BINARY_DIR}/plumbline-config-version.cmake
        DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/plumbline)
